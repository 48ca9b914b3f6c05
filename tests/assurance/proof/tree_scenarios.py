"""What happens to manifests in git, and to the history."""

from __future__ import annotations

import contextlib
import sqlite3

from histories import write_many
from proof.acts import Acts as World
from proof.given import BASE, always, declared, edition, running, scenario, service, settled

MANY, KEPT, SPARE = 1300, 1000, 50
"""Entries of a long history; how many are kept; how many more there may be until the next removal."""


def in_git(world: World) -> None:
    world.declare({"base": BASE, "cam": service()})
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "all"]):
        world.git(*words)


scenario(
    "manifest-put",
    settled(in_git),
    lambda w: w.put_manifest("base", "always_on: true", "container: {environment: {EDITION: two}}\n  always_on: true"),
    lambda w: w.changed("base"),
)
scenario("manifest-delete", settled(in_git), lambda w: w.delete_manifest("cam"))


def second_commit(world: World) -> None:
    in_git(world)
    world.start()
    world.until(base="running")
    world.rest()
    world.declare({"base": always(**edition(2)), "cam": service()})
    world.git("commit", "-qam", "second")
    world.successor("base")
    world.rest()


scenario("rollback", second_commit, lambda w: w.git_back(), lambda w: w.changed("base"))


def followed(world: World) -> None:
    world.declare({"base": BASE})
    world.tree.rename(world.upstream)
    for words in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "all"]):
        world.git(*words, folder=world.upstream)
    world.tree.mkdir()
    world.options = ("--git", str(world.upstream), "--poll", "1m")
    world.start()
    world.until(base="running")
    world.rest()


scenario(
    "git-fetch",
    followed,
    lambda w: w.commit_upstream(
        "base", "always_on: true", "always_on: true\n  container: {environment: {EDITION: two}}"
    ),
    lambda w: w.changed("base"),
)
scenario("rollback-command", second_commit, lambda w: w.command("rollback", "1"), lambda w: w.changed("base"))


def later_request(world: World) -> None:
    """A request that was made after the first commit was proven: going back there forgets it."""
    second_commit(world)
    world.request("look", "cam")
    world.until(cam="running")
    world.rest()


def restore(world: World) -> None:
    world.doubtful["look"] = [None]
    world.command("restore", "--at", "1")
    world.asked["look"] = world.doubtful.pop("look")[0]


scenario("restore-command", later_request, restore, lambda w: w.changed("base"), lambda w: w.until(cam="exited"))


def long_history(world: World) -> None:
    """More entries than are kept from the next start of rorg on."""
    write_many(world.state.journal, MANY, "what happened")
    settled(declared(base=BASE), running("base"))(world)
    world.kill()
    world.declare({"base": BASE}, policies={"robot": {"history": {"events": KEPT}}})


def trimmed(world: World) -> None:
    world.when_alive(lambda: entries(world) <= KEPT + SPARE, "old entries are not removed")


def entries(world: World) -> int:
    with contextlib.closing(sqlite3.connect(f"file:{world.state.journal}?mode=ro", uri=True)) as journal:
        return int(journal.execute("SELECT count(*) FROM entry WHERE person = 0").fetchone()[0])


scenario("retention", long_history, trimmed)
