"""Tells the targets of the Policy what goes wrong. The journal is their queue, and each has a thread of its own: one
that hangs delays neither the loop nor another target."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from rorg.daemon.notices import KINDS, Notices, Notification, body, due
from rorg.daemon.recorder import Recorder
from rorg.history.journal import Filter
from rorg.host.delivery import Undelivered, first_line, headers_of, post, run
from rorg.model.policy import NotifyTarget, Webhook
from rorg.model.units import counted

MOST = 200
"""Entries that a target gets after it was busy: the newest ones."""
PAUSES = (1.0, 4.0)
"""Seconds before the second and the third attempt. While a target fails, there is only one."""
WAKING = frozenset({*KINDS, "tree-accepted"})
"""Kinds of entries after which there is something to do."""
ENDING = 1.0
"""Seconds to wait for the commands of targets at the end."""


class Sender:
    """Tells one target everything after the entry `seq`. `changed` is called when it fails or receives again."""

    def __init__(
        self, target: NotifyTarget, seq: int, robot: Callable[[], str], recorder: Recorder, changed: Callable[[], None]
    ) -> None:
        self.target, self.seq, self.robot, self.recorder, self.changed = target, seq, robot, recorder, changed
        self.error, self.sent, self.lost = "", 0, 0
        """Why the last one was not delivered; numbers of those that were, and of those that were not."""
        self.woken, self.stopping = threading.Event(), threading.Event()
        self.thread = threading.Thread(target=self._run, name=f"notify-{target.name}", daemon=True)

    def view(self) -> dict[str, Any]:
        return {"name": self.target.name, "error": self.error, "sent": self.sent, "lost": self.lost}

    def end(self) -> None:
        self.stopping.set()
        self.woken.set()

    def _run(self) -> None:
        notices = Notices()
        while not self.stopping.is_set():
            entries = self._entries()
            notices, notifications = due(
                notices, entries, self.target, self.robot() if entries else "", time.monotonic()
            )
            for count, one in enumerate(notifications, 1):
                if not self._send(one):
                    self.lost += len(notifications) - count  # nobody is there: news must not wait behind all of these
                    break
            if not notifications:
                self.woken.wait(None if notices.next is None else max(0.0, notices.next - time.monotonic()))
                self.woken.clear()

    def _entries(self) -> list[dict[str, Any]]:
        """The entries since the last call."""
        journal, after = self.recorder.journal, self.seq
        self.seq = journal.last
        entries = (
            journal.select(Filter(kinds=frozenset(KINDS), after=after), MOST, newest=True) if self.seq > after else []
        )
        return [entry for entry in entries if entry["seq"] <= self.seq]

    def _send(self, one: Notification) -> bool:
        """Deliver it, or count it as lost. False if the target cannot be reached."""
        why, reached = "", True
        for pause in (0.0,) if self.error else (0.0, *PAUSES):
            if self.stopping.wait(pause):
                return False
            try:
                self._deliver(one)
            except Undelivered as error:
                why, reached = error.why, not error.again
            except Exception as bug:
                why, reached = f"internal error: {type(bug).__name__}", True
            else:
                why, reached = "", True
            if reached:
                break
        if not self.stopping.is_set():
            self._note(why)
        return reached

    def _deliver(self, one: Notification) -> None:
        """One attempt. Raises Undelivered."""
        target = self.target
        if target.webhook is None:
            fields = {"ROBOT": one.robot, "KIND": one.kind, "SERVICE": one.service, "MESSAGE": one.message}
            variables = {f"RORG_NOTIFY_{name}": value for name, value in fields.items()}
            run(target.command, body(one, None)[0] + b"\n", variables, target.timeout, self.stopping)
        else:
            text, media = body(one, target.webhook.template)
            post(_url(target.webhook), text, _headers(target.webhook, media), target.timeout)

    def _note(self, why: str) -> None:
        """Record the first failure, and the first success after it."""
        before, self.error = self.error, why
        self.lost, self.sent = self.lost + bool(why), self.sent + (not why)
        name = self.target.name
        if why and not before:
            text = f"cannot notify {name}: {why}; check its entry under `notify` in the Policy"
            self.recorder.event("notify-failed", text, error=why)
        elif before and not why:
            text = f"{name} receives notifications again; {counted(self.lost, 'notification')} did not reach it"
            self.recorder.event("notify-recovered", text)
        if bool(why) != bool(before):
            self.changed()


def _url(webhook: Webhook) -> str:
    return webhook.url or first_line(webhook.url_file or "")


def _headers(webhook: Webhook, media: str) -> dict[str, str]:
    given = headers_of(webhook.headers_file) if webhook.headers_file else {}
    known = {name.lower() for name in given}
    ours = {"Content-Type": media, "User-Agent": "rorg"}
    return {**{name: value for name, value in ours.items() if name.lower() not in known}, **given}


class Notifier:
    """Follows the Policy (`targets`): starts, changes and ends the threads of its targets."""

    def __init__(
        self,
        targets: Callable[[], tuple[NotifyTarget, ...]],
        robot: Callable[[], str],
        recorder: Recorder,
        changed: Callable[[], None],
    ) -> None:
        self.targets, self.robot, self.recorder, self.changed = targets, robot, recorder, changed
        self._senders: dict[str, Sender] = {}
        self._seq = recorder.journal.last
        """The last entry when the Policy was looked at: a new target gets what comes after it."""
        self._woken, self._stop = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="notify", daemon=True)

    def start(self) -> None:
        self.recorder.told = self._told
        self._thread.start()

    def _told(self, kind: str) -> None:
        if kind in WAKING:
            self._woken.set()

    def stop(self) -> None:
        self._stop.set()
        self._woken.set()
        self._thread.join(ENDING)
        senders = list(self._senders.values())
        for sender in senders:
            sender.end()
        until = time.monotonic() + ENDING
        for sender in senders:
            if sender.target.command:
                sender.thread.join(max(0.0, until - time.monotonic()))

    def view(self) -> list[dict[str, Any]]:
        """How each target is doing, as NotifyView."""
        return [sender.view() for sender in dict(self._senders).values()]

    def _run(self) -> None:
        while not self._stop.is_set():
            self._woken.clear()
            last = self.recorder.journal.last
            self._follow(self.targets())
            self._seq = last
            for sender in self._senders.values():
                sender.woken.set()
            self._woken.wait()

    def _follow(self, targets: tuple[NotifyTarget, ...]) -> None:
        before, senders = self._senders, dict[str, Sender]()
        for target in targets:
            known = before.get(target.name)
            if known is None or known.target != target:
                after = known.seq if known else self._seq
                senders[target.name] = Sender(target, after, self.robot, self.recorder, self.changed)
            else:
                senders[target.name] = known
        self._senders = senders
        for name, sender in before.items():
            if senders.get(name) is not sender:
                sender.end()
        for sender in senders.values():
            if not sender.thread.ident:
                sender.thread.start()
        if before.keys() != senders.keys():
            self.changed()
