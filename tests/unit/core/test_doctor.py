"""`rorg doctor`: facts of an installation are gathered once, as a value, and what is wrong is said of them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rorg.core.doctor import ERROR, OK, WARNING, examine
from rorg.history.journal import fault
from rorg.host import installation as host
from rorg.model.installation import Installation, Space

SOUND = Installation(
    engine_host="unix:///run/docker.sock",
    engine_version="20.10",
    state_dir="/var/lib/rorg",
    running=12,
    answers=True,
    git_version="git version 2.39",
    spaces=(Space("/", 50 << 30, 100 << 30, 1 << 20),),
    sysctls={"fs.inotify.max_user_watches": 65536, "fs.inotify.max_user_instances": 128},
)
WRONG = [
    ({"engine_error": "No such file or directory"}, "engine", ERROR, "systemctl start docker"),
    ({"engine_error": "Permission denied", "engine_denied": True}, "engine", ERROR, "usermod -aG docker"),
    ({"live_restore": False}, "live-restore", WARNING, "daemon.json"),
    ({"pressure": False}, "pressure", WARNING, "psi=1"),
    ({"state_error": "you may not write to /var/lib"}, "state-directory", ERROR, "RORG_STATE_DIR"),
    ({"journal_error": "file is not a database"}, "journal", ERROR, "systemctl restart rorg"),
    ({"journal_damaged": ("/var/lib/rorg/journal.damaged-1.db",)}, "journal", WARNING, "sqlite3 FILE .recover"),
    ({"answers": False}, "rorg", ERROR, "journalctl -u rorg"),
    ({"answers": False, "running": 0}, "rorg", WARNING, "rorg run"),
    ({"socket_error": "you are not in the group rorg"}, "rorg", ERROR, "group"),
    ({"git_version": ""}, "git", WARNING, "install git"),
    ({"git_refusal": "git does not trust it; try `git config`"}, "git", WARNING, "`git config`"),
    ({"clock_synchronized": False}, "clock", WARNING, "set-ntp"),
    ({"spaces": (Space("/", 1 << 30, 100 << 30),)}, "disk /", WARNING, "rorg image prune"),
    ({"spaces": (Space("/", 1 << 20, 100 << 30),)}, "disk /", ERROR, "rorg image prune"),
    ({"spaces": (Space("/", 50 << 30, 100 << 30, 12),)}, "disk /", WARNING, "rorg image prune"),
    ({"sysctls": {"fs.inotify.max_user_watches": 8192}}, "inotify", WARNING, "sysctl -w fs.inotify.max_user_watches"),
    ({"open_files": 256}, "open-files", WARNING, "LimitNOFILE"),
]


def test_a_sound_installation_has_nothing_to_do():
    found = examine(SOUND)
    assert {c.status for c in found} == {OK}
    assert not any(c.remedy for c in found)
    assert len({c.name for c in found}) == len(found)


@pytest.mark.parametrize(("facts", "name", "status", "remedy"), WRONG)
def test_what_is_wrong_is_said_with_what_to_do(facts, name, status, remedy):
    (found,) = [c for c in examine(replace(SOUND, **facts)) if c.status != OK]
    assert (found.name, found.status) == (name, status)
    assert remedy in found.remedy
    assert found.message


def test_what_is_well_is_told():
    told = {check.name: check.message for check in examine(replace(SOUND, socket="/run/rorg/rorg.sock", cgroup=1))}
    assert told == {
        "engine": "Docker 20.10 answers at unix:///run/docker.sock",
        "cgroup": "control groups v1",
        "pressure": "the kernel reports pressure (PSI)",
        "state-directory": "/var/lib/rorg",
        "journal": "the history can be read",
        "rorg": "rorg answers at /run/rorg/rorg.sock",
        "git": "git version 2.39",
        "clock": "it is synchronized",
        "disk /": "50Gi of 100Gi are free",
        "inotify": "files can be watched",
    }
    (clock,) = [c for c in examine(replace(SOUND, clock_synchronized=None)) if c.name == "clock"]
    assert (clock.status, clock.message) == (OK, "the kernel does not say whether it is synchronized")
    assert examine(SOUND)[0].as_json() == {
        "check": "engine",
        "status": "ok",
        "message": "Docker 20.10 answers at unix:///run/docker.sock",
        "remedy": "",
    }


@pytest.mark.parametrize(
    ("space", "status", "message"),
    [
        (Space("/", 2 << 30, 4 << 30), OK, "2.0Gi of 4.0Gi are free"),
        (
            Space("/", (2 << 30) - 1, 4 << 30),
            WARNING,
            "less than 2.0Gi are free, which an image may need: 2.0Gi of 4.0Gi",
        ),
        (Space("/", 200 << 20, 4 << 30), WARNING, "less than 2.0Gi are free, which an image may need: 200Mi of 4.0Gi"),
        (
            Space("/", (200 << 20) - 1, 4 << 30),
            ERROR,
            "less than 200Mi are free, which the history may need: 200Mi of 4.0Gi",
        ),
        (Space("/", 12 << 20, 12 << 20), ERROR, "less than 200Mi are free, which the history may need: 12Mi of 12Mi"),
        (Space("/", 2 << 30, 4 << 30, 10_000), OK, "2.0Gi of 4.0Gi are free"),
        (Space("/", 2 << 30, 4 << 30, 9_999), WARNING, "9999 more files can be created"),
        (Space("/", 2 << 30, 4 << 30, 1), WARNING, "1 more files can be created"),
    ],
)
def test_a_disk_is_judged_by_what_is_free(space, status, message):
    (found,) = [c for c in examine(replace(SOUND, spaces=(space,))) if c.name == "disk /"]
    assert (found.status, found.message) == (status, message)


@pytest.mark.parametrize(
    ("facts", "wrong"),
    [
        ({"sysctls": {}}, {}),
        ({"sysctls": {"fs.inotify.max_user_watches": 16384, "fs.inotify.max_user_instances": 64}}, {}),
        ({"open_files": 1024}, {}),
        ({"open_files": 1023}, {"open-files": "1023 open files are allowed: many services need more"}),
        (
            {"sysctls": {"fs.inotify.max_user_watches": 16383, "fs.inotify.max_user_instances": 1}, "open_files": 1},
            {
                "inotify": "fs.inotify.max_user_watches is 16383: changes of files may be seen late",
                "open-files": "1 open files are allowed: many services need more",
            },
        ),
        (
            {"sysctls": {"fs.inotify.max_user_instances": 63}},
            {"inotify": "fs.inotify.max_user_instances is 63: changes of files may be seen late"},
        ),
    ],
)
def test_limits_are_judged_one_by_one(facts, wrong):
    assert {c.name: c.message for c in examine(replace(SOUND, **facts)) if c.status != OK} == wrong


def test_each_reason_why_options_are_without_effect_is_told_once():
    lacks = {"cpus": "no cgroups", "mem_limit": "no cgroups", "ipc": "not supported"}
    found = [c for c in examine(replace(SOUND, engine_lacks=lacks)) if c.name == "engine-lacks"]
    assert [(c.status, c.message) for c in found] == [
        (WARNING, "cpus, mem_limit: no cgroups"),
        (WARNING, "ipc: not supported"),
    ]


def test_another_engine_needs_no_docker():
    found = examine(replace(SOUND, engine="process", engine_error="nobody"))
    assert {c.status for c in found} == {OK}


# -- facts -----------------------------------------------------------------------------------------------------


def test_a_directory_that_is_not_there_yet_is_judged_by_where_it_would_be(tmp_path):
    assert host.writable(tmp_path / "a/b") == ""
    (tmp_path / "file").write_text("")
    assert host.writable(tmp_path / "file/b") == f"{tmp_path}/file is no directory"
    found = host.space(tmp_path / "a/b")
    assert found is not None
    assert (found.path, 0 < found.free <= found.total) == (str(tmp_path), True)


def test_a_spoilt_history_is_known(tmp_path):
    path = tmp_path / "journal.db"
    assert fault(path) == ""
    path.write_bytes(b"no database" * 1000)
    assert "not a database" in fault(path)
