"""Wrong and odd command lines: each has its exit code, and one line that says the cause and a remedy."""

from __future__ import annotations

import os
import re
import shlex
from pathlib import Path

import pytest
from all_commands import Commands
from robots import RealRobot, write_tree

from rorg.cli.commands import ALIASES, COMMANDS
from rorg.cli.mistakes import LOOKING, one_slip, suggestion

SERVICES = {"arm": {}, "navigation": {"needs": ["arm"]}, "base": {"always_on": True}}
GROUPS = {"driving": {"services": ["navigation", "base"]}}
HUGE = "9" * 400

UNREAD = """
relase arm; stpo arm; stat; st; dow; rm arm; delete service arm; kill arm; unhold arm; resume; list
Get
''; ' '; é; navigation; get-services; ../get; 'get services'; -; --nonsense; -x; --state-dir /x get; --yes
--versio
get --wach; get --watch=3; get -o; get -ojson -oyaml x y; get --output; get a b c; get -z; get --state-dir
get --engine
describe; describe arm arm; describe --deep arm; why; why ''; why arm arm; why --outptu json arm
request; request --id x; request arm --ttl; request arm --ttl soon; request arm --ttl 5q; request arm --ttl -5s
request arm --ttl 1e400s; request arm --priority 101; request arm --priority -1; request arm --priority 1.5
request arm --priority HUGE; request arm --timeout x; request arm --timeout ''; request arm --wait=yes
request arm --as
release; release a b; release --all; release tour --as; start; stop; stop a b; start arm --ttl soon; up a b
up --nosuch
restart; restart a b; restart arm --timeout soon; restart --yes; retry; retry --yes; retry arm --output
hold; hold arm --for; hold arm --for ten; hold arm --for 10x; hold arm --for ''; hold --for 10m; hold arm --until 5
suspend arm; suspend --for; suspend --for never; suspend --ende; wait --timeout; wait arm --timeout soon; down now
down --timeout x; down --keep; events --tail; events --tail x; events --tail -1; events --tail 1.5
events -n 3; events --since soon; events --until 10x; events --kind; events --kind bogus
history -n 0; history -n 1001; history -n x
trace; trace show a b; trace generate --seed x; trace generate --duration soon; trace record --since soon
timeline; timeline a b; timeline arm --since soon; timeline arm -n -1
fit --margin much; fit --margin 200%; fit --since soon
logs; logs arm arm; logs arm --tail x; logs arm --tail -1; logs arm --lines 3; logs --follow; top x
top --interval 0
top --interval x; top --interval 0.1; validate a b; validate --fix; diff a b; diff --color; apply a b
apply --timeout x
apply --force; run a b; run --port 1; run --listen; graph a b; graph -x; build --image a; init a b
build --jobs 0; build --jobs x
init --force x
schema a b; completion; completion a b; exec; exec arm; exec arm ls -la; exec --user x arm -- ls; shell; shell a b
cp; cp a
dev --workspace; dev --name; dev arm -x; dev arm --nosuch; dev arm ls -la
simulate; simulate a b c; simulate a --seed x; simulate a --seed 1.5; simulate a --every 0; simulate a --every soon
cp a b c; cp -r a b; edit; edit a b; edit --force arm; demo x; demo --speed x; demo --speed 0; demo --speed nan
emulate; emulate --pairs 0 a-file; emulate a-file --compress 0.5; emulate a-file --scale 2; emulate a-file --pairs x
"""
"""What is said of them is said before anything is looked at: exit code 2."""

ALONE = {
    2: """
get nonsense; get sevices; get services nosuch; get groups nosuch; get images nosuch
get requests nosuch
get -o yml; get -o ''; get -o JSON; get --engine podman; get --engine ''x; get LINES; get --manifests nosuch
get --manifests a-file; get --manifests empty; get --manifests broken
describe amr; describe nosuch; describe arm -o table2; why amr; why nosuch -o json; why é
why ../arm
why arm -o nosuch; request amr; request ''; request arm ''; request arm --id ''' '''; request arm --id a/b
request arm --ttl 0s
request arm --as nobody; request driving nosuch; request arm --engine x
restart nosuch; restart ''; retry nosuch; retry ''; hold nosuch --for 10m; hold arm; hold arm --for 0s
hold arm --for 10m --end
hold '' --for 1m; suspend; suspend --for 0s; suspend --for 10m --end; wait; events -o nosuch; events -f --until 1m
history nosuch; history show; history show 1 2; history show 1; history show é; history diff; history diff a b c
import; import nosuch; import compose nosuch.yaml; import compose a-file; import systemd; import systemd nosuch
import roslaunch a-file x; import compose -o nosuch; export; export nosuch; export compose -o nosuch
trace x; trace show; trace show nosuch; trace show a-file; trace record a; trace generate a; trace show a-file -o nosuch
trace generate --greetings 1 --tours 2; trace generate --greetings 9999; trace generate --file nosuch/x; trace record
emulate nosuch; emulate nosuch nosuch; emulate nosuch --engine x; emulate nosuch -o nosuch; emulate nosuch a-file
history export x; history export --format xml; history -o nosuch; timeline arm; timeline nosuch; timeline arm -o nosuch
logs nosuch; logs arm; logs driving; validate nosuch; validate a-file; validate empty; validate /dev/null
validate ''x
diff nosuch; diff a-file; diff empty; diff -o nosuch; apply nosuch --yes; apply empty --yes; run nosuch; run a-file
run --listen x; run --listen 0.0.0.0:1; run --listen :0 --tls-cert a; graph nosuch; graph -o nosuch; graph empty
build nosuch; build --manifests nosuch; schema a-file/x; completion tcsh; completion ''x; init a-file; init /proc/x
exec nosuch -- ls; exec '' -- ls; exec arm -- ''; exec -it arm -- ls; exec driving -- ls; shell nosuch
shell driving
cp a-file b; cp arm:/a base:/b; cp arm: .; cp :x .; cp nosuch arm:/x; cp arm:/x /nosuch/y; cp nosuch:/x .
edit nosuch; edit x/y; edit ''; edit service/; edit /arm; edit image/arm; edit ../services/arm
edit arm --manifests nosuch; fit nosuch; fit -o nosuch; fit arm --manifests nosuch
dev; dev arm; dev --stop; dev arm --stop --fresh; dev --fresh; dev --devcontainer; dev -o nosuch; dev arm -- ls
simulate nosuch --compare linger=1s; simulate nosuch --sweep linger=1s
simulate nosuch; simulate day.yaml nosuch; simulate day.yaml -o nosuch; simulate empty; simulate day.yaml empty
edit arm; diff --state-dir a-file; request arm --state-dir a-file/x; get --state-dir /dev/null
""",
    3: "wait arm; wait nosuch; request arm --wait; restart base --wait; events -f",
    4: "exec arm -- ls; shell base; cp arm:/x .; cp a-file base:/x",
    5: "down; apply; restart arm; init manifests; init manifests/../manifests",
    0: "--; --version; --help; -h; get --help; ps -h; ls services; status -o name; get services arm; up --help\n"
    "version; help; help get; help ps\n"
    "--help x; release nosuch; release ''; release é; stop nosuch",
}
"""Where no rorg runs, in a directory with manifests/, by exit code."""

SERVED = {
    2: """
get nonsense; get services nosuch; get groups ''x; describe nosuch; describe é; why nosuch; why a/b; why ..
why '%2e%2e'
request nosuch; request a/b; request arm --as nobody; request arm --id a/b; request arm é
restart nosuch; restart ..; hold nosuch --for 1m; hold arm --for 0s; wait nosuch; logs nosuch; diff nosuch
exec nosuch -- ls; edit nosuch; edit groups/arm; get -o nosuch; why arm -o nosuch; events -o nosuch
dev base
history show 99; history show ..; history show a/diff/b; history diff 1 99; history show -- --all
timeline nosuch; trace record --since 1h --until 2h; trace show nosuch; trace record --file nosuch/x
events --tail 3 --since 1h -o nosuch
suspend --for 0s; wait a/b; exec base -- ''; exec -t base -- ls; edit driving; edit arm; request arm --reason LONG
""",
    4: "request navigation --id tour --wait --timeout 0; apply --wait --yes --timeout 0",
    5: "run manifests; apply manifests --yes; down",
    0: "release nosuch; release a/b; stop nosuch; ps; ls; status; why arm; start arm --id other; stop other; up -h",
}
"""Beside a running rorg."""


def split(text: str) -> list[str]:
    return [line for line in (part.strip(" \n") for part in text.replace("\n", ";").split(";")) if line]


def words_of(line: str) -> list[str]:
    return [{"HUGE": HUGE, "LONG": "x" * 100000, "LINES": "a\nb\x1b[2J"}.get(word, word) for word in shlex.split(line)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    found = tmp_path_factory.mktemp("lines")
    write_tree(found / "manifests", SERVICES, groups=GROUPS)
    write_tree(found / "broken", {"arm": {"nonsense": 1}})
    (found / "empty").mkdir()
    (found / "a-file").write_text("x")
    return found


@pytest.fixture(scope="module")
def alone(folder):
    return Commands(folder, folder / "state")


@pytest.fixture(scope="module")
def served(folder, tmp_path_factory):
    robot = RealRobot(tmp_path_factory.mktemp("served"), "process", None, with_server=True)
    robot.declare(SERVICES, groups=GROUPS)
    robot.wait(lambda: "base" in robot.active())
    robot.settle()
    yield Commands(folder, robot.state.path)
    robot.close()


@pytest.fixture(scope="module")
def refused(folder, tmp_path_factory):
    """Beside a running rorg all of whose manifests are refused."""
    robot = RealRobot(tmp_path_factory.mktemp("refused"), "process", None, with_server=True)
    robot.declare({"arm": {"nonsense": 1}})
    robot.wait(lambda: robot.loop.tree.errors)
    yield Commands(folder, robot.state.path)
    robot.close()


DO = "change|create|fix|name|start|stop|use"
"""What remedies of these lines begin with, besides "try"."""


def held(line: str, code: int, told: tuple[int, str, str]) -> list[str]:
    """What is wrong with an answer."""
    got, out, err = told
    err = "".join(line for line in err.splitlines(True) if not line.startswith("no rorg runs on "))  # stands above
    # A tree or trace with mistakes has a line for each; what is refused is shown before.
    long = code in (4, 5) or any(word in line for word in ("broken", "empty", "import compose", "trace show"))
    checks = {
        f"exit code {got}, not {code}": got == code,
        "a traceback": "Traceback" not in err + out and "internal error" not in err,
        "no cause and remedy": not code
        or re.search(rf"(?s)^rorg: cannot [^\n]*: .*(; |\n)(try|{DO}) ", err, re.MULTILINE),
        "several lines": not code or long or len(err.splitlines()) == 1,
        "data where there is an error": code in (0, 4) or not out,
        "a control character": (err + out).replace("\n", "").isprintable(),
    }
    return [f"{line[:60]!r}: {why}: {err[:300]!r}" for why, fine in checks.items() if not fine]


def all_held(run: Commands, lines: list[tuple[str, int]], **environment: str) -> None:
    wrong = [w for line, code in lines for w in held(line, code, run(words_of(line), **environment))]
    assert not wrong, "\n".join(wrong)


def by_code(table: dict[int, str]) -> list[tuple[str, int]]:
    return [(line, code) for code, text in table.items() for line in split(text)]


def test_there_are_many():
    assert len(split(UNREAD)) + len(by_code(ALONE)) + len(by_code(SERVED)) >= 300


@pytest.mark.slow
def test_lines_that_say_nothing_sensible(alone):
    all_held(alone, [(line, 2) for line in split(UNREAD)])


@pytest.mark.slow
def test_lines_where_no_rorg_runs(alone):
    all_held(alone, by_code(ALONE))


@pytest.mark.slow
def test_lines_beside_a_running_rorg(served):
    all_held(served, by_code(SERVED))


UNSENT = ["why", "logs", "diff", "wait", "stop", "restart", "timeline", "history show", "events --kind"]
UNSENT += ["request arm --as", "request arm --reason", "hold arm --for 1m --reason", "hold --for 1m"]


@pytest.mark.parametrize("line", UNSENT)
def test_what_is_not_utf8_cannot_be_sent(served, line):
    """A shell hands on any bytes, as in the name of a file of another system."""
    told = served([*words_of(line), os.fsdecode(b"\xff\xfe")])
    assert not held(line, 2, told)


@pytest.mark.parametrize("line", ["request arm", "request arm --wait", "why arm", "hold arm --for 1m", "restart arm"])
def test_without_manifests_in_force_a_name_is_not_the_mistake(refused, line):
    told = refused(words_of(line))
    assert not held(line, 5, told)
    assert re.search(r": no manifests are in force: \S+/arm.yaml:\d+:\d+: unknown key 'nonsense'; try ", told[2]), told[
        2
    ]


@pytest.mark.slow
@pytest.mark.parametrize("columns", ["60", "200"])
def test_neither_width_nor_colour_changes_what_is_piped(alone, served, columns):
    lines = ["relase", "get --wach", "request arm --ttl 5q", "why", "get nonsense", "logs nosuch"]
    for line in [*lines, "get services", "get -o wide", "why arm"]:
        run = served if line in ("get services", "get -o wide", "why arm") else alone
        plain = ageless(run(words_of(line)))
        assert ageless(run(words_of(line), COLUMNS=columns, NO_COLOR="1", TERM="dumb")) == plain
        assert ageless(run(words_of(line), COLUMNS=columns, TERM="xterm-256color", FORCE_COLOR="1")) == plain


def ageless(told: tuple[int, str, str]) -> tuple[int, str, str]:
    """Time goes on between two answers."""
    return told[0], re.sub(r"\b\d+s\b +", "AGE ", told[1]), told[2]


# -- suggestions -----------------------------------------------------------------------------------------------

SUGGESTED = {
    "relase": "release",
    "reelase": "release",
    "stpo": "stop",
    "stopp": "stop",
    "strat": "start",
    "stat": "status",
    "st": "status",
    "sta": "status",
    "lgos": "logs",
    "gett": "get",
    "validat": "validate",
    "explane": None,
    "re": None,
    "unhold": "request",
    "unrequest": None,
    "unstart": "status",
    "x": None,
}


@pytest.mark.parametrize(("word", "name"), SUGGESTED.items())
def test_the_nearest_safe_command_is_suggested(word, name):
    assert suggestion(word).startswith(f"`rorg {name or '--help'}")


def test_never_the_opposite_and_nothing_that_removes_without_saying_so():
    opposites = [("start", "stop"), ("request", "release"), ("up", "down")]
    letters = "abcdefghijklmnopqrstuvwxyz"
    for first, second in [*opposites, *((b, a) for a, b in opposites)]:
        slips = {
            first[:i] + letter + first[i + cut :]
            for i in range(len(first) + 1)
            for letter in ("", *letters)
            for cut in (0, 1)
        }
        for word in slips - {*COMMANDS, *ALIASES}:
            if not one_slip(word, second):
                assert f"`rorg {second}`" not in suggestion(word), word
    for word in ("dow", "don", "donw", "delete", "rm", "remove", "uninstall"):
        assert "remove" in suggestion(word), word
    few = "adelnoprstuw"
    for word in (f"{a}{b}{c}" for a in few for b in few for c in few if f"{a}{b}{c}" not in COMMANDS):
        named = suggestion(word).partition("`rorg ")[2].partition("`")[0]
        assert named == "--help" or " " in named or named in LOOKING or "` (" in suggestion(word), word
