"""The part of the table of codes that is about containers and the machine."""

from __future__ import annotations

from rorg.manifest.validation.code import ERROR, WARNING, Code

DEVICES = {
    "privileged": Code(
        WARNING,
        "One mistake in it, or one attack on it, reaches the whole machine.",
        "driver: {devices, groups, realtime}, which give what is needed",
    ),
    "sys-admin": Code(WARNING, "It lets a container mount the machine's disks.", "the one capability that is needed"),
    "whole-dev-mounted": Code(
        WARNING, "It reaches all disks, and the machine's /dev/shm too.", "driver: {devices: [...]}"
    ),
    "unstable-device-path": Code(
        WARNING, "The kernel numbers these in the order in which it finds them.", "/dev/serial/by-id/..."
    ),
    "missing-device": Code(
        WARNING,
        "The container cannot start, nor start again after an unplug.",
        "plugging it in, or its name in /dev/serial/by-id",
        machine=True,
    ),
    "device-as-volume": Code(
        WARNING, 'Opening it fails with "operation not permitted", even for root.', "driver: {devices: [...]}"
    ),
    "device-shared": Code(WARNING, "Two programs on one port each get half of the data.", "conflicts between the two"),
    "device-without-group": Code(
        WARNING, "The device exists, but the program may not open it.", "driver: {groups: [dialout]}"
    ),
    "realtime-without-sys-nice": Code(
        WARNING,
        "Limits alone do not let a container's root raise its priority; SYS_NICE does.",
        "driver: {realtime: true}",
    ),
    "sys-nice-without-rtprio": Code(
        WARNING, "Only root's programs keep capabilities; others have only limits.", "driver: {realtime: true}"
    ),
    "display-without-x11": Code(
        WARNING, "It ends when it opens its first window.", 'volumes: ["/tmp/.X11-unix:/tmp/.X11-unix:ro"]'
    ),
    "x11-private-ipc": Code(
        WARNING,
        "X11 programs show black windows or end with BadAccess: the server cannot read their shared memory.",
        'environment: {QT_X11_NO_MITSHM: "1"}, as the profile x11 has it, or ipc: host',
    ),
    "gpu-variables-without-gpu": Code(WARNING, "The variable alone has no effect.", "gpus: all"),
    "gpu-without-runtime": Code(
        WARNING, "The engine cannot create the container on this machine.", "the NVIDIA container toolkit", machine=True
    ),
}
MOUNTS = {
    "socket-file-mounted": Code(ERROR, "A mounted socket file is dead once its program restarts.", "its directory"),
    "engine-socket-mounted": Code(
        WARNING,
        "A program that can talk to the engine can mount the whole machine.",
        "may_request or may_manage, by which rorg does it",
    ),
    "missing-mount-source": Code(
        WARNING, "The engine creates an empty directory instead, and the program fails silently.", "creating it"
    ),
    "mount-not-writable": Code(
        WARNING, "Its logs, bags or maps are lost.", "another owner of the directory", machine=True
    ),
    "mount-over-system": Code(WARNING, "The image's own programs disappear.", "a directory of its own inside"),
    "whole-host-mounted": Code(WARNING, "A mistake in it deletes the machine's files.", "the one directory, or :ro"),
    "missing-file": Code(WARNING, "The program ends immediately, at every start.", "creating it"),
    "program-not-executable": Code(WARNING, "The container cannot start: permission denied.", "chmod +x"),
    "script-with-crlf": Code(WARNING, "The container cannot start: no such file or directory.", "line ends of Unix"),
    "shell-words-without-shell": Code(
        WARNING,
        "rorg splits a command into words and runs no shell.",
        'command: [bash, -c, "..."] with exec before the last program',
    ),
    "program-in-background": Code(
        WARNING,
        "The container keeps running and counts as ready when half of it is gone.",
        "a Service of its own for each program",
    ),
    "sudo-without-privileges": Code(WARNING, "The command fails immediately.", "user: root, and no sudo"),
}
LIMITS = {
    "limit-below-expected": Code(WARNING, "It is killed or slowed down during normal work.", "a higher limit"),
    "always-on-over-budget": Code(
        WARNING, "The machine is overloaded before anything is requested.", "fewer services that are always on"
    ),
    "budget-without-resources": Code(
        WARNING,
        "rorg admits it regardless of what else runs.",
        "resources: {cpu: 0.5, memory: 100Mi}",
    ),
    "read-only-ros": Code(
        WARNING,
        "It ends immediately, because it cannot create a log directory.",
        "tmpfs: [/tmp], with ROS_LOG_DIR: /tmp/ros",
    ),
    "user-without-home": Code(
        WARNING,
        "It ends immediately, because it cannot create the directory /.ros.",
        "environment: {ROS_HOME: /tmp/ros}, or HOME",
    ),
    "log-without-limits": Code(
        WARNING,
        "A full disk stops everything.",
        'logging: {driver: json-file, options: {max-size: 10m, max-file: "3"}}',
    ),
    "recording-without-limit": Code(WARNING, "A full disk stops everything.", "--split --size=1024 --max-splits=20"),
    "tty-without-stdin": Code(
        WARNING, "Programs format their output for a terminal that nobody watches.", "stdin_open: true, or dropping tty"
    ),
    "shm-size-with-ipc-host": Code(WARNING, "The engine ignores it.", "dropping one of them"),
    "oom-kill-disabled-without-limit": Code(WARNING, "The kernel kills everything else first.", "mem_limit"),
    "nofile-too-high": Code(
        WARNING,
        "Python closes every possible descriptor up to the limit, one by one.",
        "nofile: {soft: 1024, hard: 524288}",
    ),
    "time-zones-differ": Code(WARNING, "You cannot compare times in the logs.", "one TZ, in a profile"),
}
PROGRAMS = {
    "latest-tag": Code(WARNING, "A rollback cannot find the earlier image.", "a tag with a version, or a digest"),
    "ros-version-of-image": Code(
        WARNING, "The program is missing, and the container ends immediately.", "an image of the other ROS"
    ),
    "ros-entrypoint-replaced": Code(
        WARNING, "The ROS programs are not on the path.", "/ros_entrypoint.sh as the first word of the entry point"
    ),
    "misspelt-image": Code(WARNING, "The image does not exist, and the service waits forever.", "the Image's name"),
    "misspelt-variable": Code(WARNING, "A misspelt variable silently has no effect.", "its right name"),
    "costly-probe": Code(
        WARNING, "A dozen of these use a whole core.", "ros_node, ros_topic or ros_service, which cost 2 ms"
    ),
    "ready-without-healthcheck": Code(WARNING, "It never becomes ready.", "a healthcheck, or another form of `ready`"),
    "sleep-as-readiness": Code(
        WARNING,
        "The sleep is too short on a slow day, and too long on all others.",
        "needs, and `ready` on what it waits for",
    ),
    "secret-in-manifest": Code(
        WARNING, "Everyone who can read the repository can read it.", "env_file, or secrets: [NAME]"
    ),
    "python-output-held-back": Code(
        WARNING, "The last output before a crash is lost.", 'environment: {PYTHONUNBUFFERED: "1"}'
    ),
    "unconfined": Code(WARNING, "The container can exploit kernel bugs that the profile blocks.", "dropping it"),
    "requests-itself": Code(
        WARNING,
        "A request counts only while something else wants its requester.",
        "a request of developer, or always_on: true",
    ),
}
MACHINE = {
    "device-of-other-group": Code(
        WARNING, "The device exists, but the program may not open it.", "its group, by number", machine=True
    ),
    "missing-host-path": Code(
        WARNING,
        "The engine creates an empty directory instead, and the program fails silently.",
        "creating it",
        machine=True,
    ),
    "missing-runtime": Code(
        WARNING, "The engine cannot create the container.", "installing it, or another runtime", machine=True
    ),
    "port-in-use": Code(
        WARNING,
        "The container cannot start while another program has the port.",
        "another port, or ending that program",
        machine=True,
    ),
    "limit-above-kernel": Code(
        WARNING,
        "The engine cannot grant more than it has itself.",
        "a smaller limit, or a higher one for the engine",
        machine=True,
    ),
    "more-than-machine": Code(WARNING, "This machine does not have that much.", "less of it", machine=True),
    "cgroup-version": Code(WARNING, "This machine's kernel does not support that option.", "dropping it", machine=True),
    "realtime-throttled": Code(
        WARNING,
        "Real-time programs are throttled or refused.",
        "kernel.sched_rt_runtime_us as the kernel has it: 950000",
        machine=True,
    ),
}
