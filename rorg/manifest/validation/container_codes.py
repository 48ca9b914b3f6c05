"""The part of the table of codes that is about containers and the machine."""

from __future__ import annotations

from rorg.manifest.validation.code import ERROR, WARNING, Code

DEVICES = {
    "privileged": Code(
        WARNING,
        "One mistake in it, or one attack on it, has the whole machine.",
        "driver: {devices, groups, realtime}, which give what is needed",
    ),
    "sys-admin": Code(
        WARNING, "With it a container can mount the machine's disks.", "the one capability that is needed"
    ),
    "whole-dev-mounted": Code(
        WARNING, "It reaches all disks, and the machine's /dev/shm besides.", "driver: {devices: [...]}"
    ),
    "unstable-device-path": Code(
        WARNING, "The kernel counts these up in the order in which it finds them.", "/dev/serial/by-id/..."
    ),
    "missing-device": Code(
        WARNING,
        "The container cannot start, nor start again after an unplug.",
        "plugging it in, or its name in /dev/serial/by-id",
        machine=True,
    ),
    "device-as-volume": Code(WARNING, "Operation not permitted, also for root.", "driver: {devices: [...]}"),
    "device-shared": Code(WARNING, "Two programs at one port get half of the data each.", "conflicts between the two"),
    "device-without-group": Code(WARNING, "The device is there, and may not be opened.", "driver: {groups: [dialout]}"),
    "realtime-without-sys-nice": Code(
        WARNING,
        "Limits alone do not let a container's root raise its priority; SYS_NICE does.",
        "driver: {realtime: true}",
    ),
    "sys-nice-without-rtprio": Code(
        WARNING, "Programs of another user than root have no capabilities, only limits.", "driver: {realtime: true}"
    ),
    "display-without-x11": Code(
        WARNING, "The first window that it opens ends it.", 'volumes: ["/tmp/.X11-unix:/tmp/.X11-unix:ro"]'
    ),
    "x11-private-ipc": Code(
        WARNING,
        "Programs of X11 show black windows, or end with BadAccess: the screen cannot read memory of another ipc.",
        'environment: {QT_X11_NO_MITSHM: "1"}, as the profile x11 has it, or ipc: host',
    ),
    "gpu-variables-without-gpu": Code(WARNING, "The variable alone gives nothing.", "gpus: all"),
    "gpu-without-runtime": Code(
        WARNING, "The container cannot be made on this machine.", "the NVIDIA container toolkit", machine=True
    ),
}
MOUNTS = {
    "socket-file-mounted": Code(
        ERROR, "A mounted socket is dead for ever once its program has started again.", "its directory"
    ),
    "engine-socket-mounted": Code(
        WARNING,
        "Who speaks to the engine can mount the whole machine.",
        "may_request or may_manage, by which rorg does it",
    ),
    "missing-mount-source": Code(
        WARNING, "The engine makes an empty directory in its place, and the program fails unseen.", "creating it"
    ),
    "mount-not-writable": Code(
        WARNING, "Its logs, bags or maps are lost.", "another owner of the directory", machine=True
    ),
    "mount-over-system": Code(WARNING, "Programs of the image are gone.", "a directory of its own inside"),
    "whole-host-mounted": Code(WARNING, "A mistake in it deletes the machine's files.", "the one directory, or :ro"),
    "missing-file": Code(WARNING, "The program ends at once, as often as it is started.", "creating it"),
    "program-not-executable": Code(WARNING, "The container cannot start: permission denied.", "chmod +x"),
    "script-with-crlf": Code(WARNING, "The container cannot start: no such file or directory.", "line ends of Unix"),
    "shell-words-without-shell": Code(
        WARNING,
        "rorg splits a command into words and runs no shell.",
        'command: [bash, -c, "..."] with exec before the last program',
    ),
    "program-in-background": Code(
        WARNING,
        "The container goes on, and counts as ready, when half of it is gone.",
        "a Service of its own for each program",
    ),
    "sudo-without-privileges": Code(WARNING, "The command fails at once.", "user: root, and no sudo"),
}
LIMITS = {
    "limit-below-expected": Code(
        WARNING, "It is killed, or held back, while it does what is expected.", "a higher limit"
    ),
    "always-on-over-budget": Code(
        WARNING, "The machine is overloaded before anything was requested.", "fewer services that are always on"
    ),
    "budget-without-resources": Code(
        WARNING,
        "It is admitted whatever else runs: too much at once.",
        "resources: {cpu: 0.5, memory: 100Mi}",
    ),
    "read-only-ros": Code(
        WARNING, "It ends at once: cannot create a log directory.", "tmpfs: [/tmp], with ROS_LOG_DIR: /tmp/ros"
    ),
    "user-without-home": Code(
        WARNING,
        "It ends at once: it cannot make the directory /.ros.",
        "environment: {ROS_HOME: /tmp/ros}, or HOME",
    ),
    "log-without-limits": Code(
        WARNING,
        "A full disk stops everything.",
        'logging: {driver: json-file, options: {max-size: 10m, max-file: "3"}}',
    ),
    "recording-without-limit": Code(WARNING, "A full disk stops everything.", "--split --size=1024 --max-splits=20"),
    "tty-without-stdin": Code(
        WARNING, "Programs draw for a person who is not there.", "stdin_open: true, or dropping tty"
    ),
    "shm-size-with-ipc-host": Code(WARNING, "The engine ignores it.", "dropping one of them"),
    "oom-kill-disabled-without-limit": Code(WARNING, "The kernel kills everything else first.", "mem_limit"),
    "nofile-too-high": Code(
        WARNING, "Python closes file by file up to the limit.", "nofile: {soft: 1024, hard: 524288}"
    ),
    "time-zones-differ": Code(WARNING, "Times in logs cannot be compared.", "one TZ, in a profile"),
}
PROGRAMS = {
    "latest-tag": Code(WARNING, "A rollback does not find its image again.", "a tag with a version, or a digest"),
    "ros-version-of-image": Code(
        WARNING, "The program is not there, and the container ends at once.", "an image of the other ROS"
    ),
    "ros-entrypoint-replaced": Code(
        WARNING, "Nothing of ROS is on the path.", "/ros_entrypoint.sh as the first word of the entry point"
    ),
    "misspelt-image": Code(WARNING, "The image cannot be had, and the service waits for ever.", "the Image's name"),
    "misspelt-variable": Code(WARNING, "A variable with another name has no effect, in silence.", "its right name"),
    "costly-probe": Code(
        WARNING, "A dozen of these take a core.", "ros_node, ros_topic or ros_service, which cost 2 ms"
    ),
    "ready-without-healthcheck": Code(WARNING, "It never becomes ready.", "a healthcheck, or another form of `ready`"),
    "sleep-as-readiness": Code(
        WARNING, "It is too short on a slow day, and too long on all others.", "needs, and `ready` on what it waits for"
    ),
    "secret-in-manifest": Code(WARNING, "Whoever may see the repository has it.", "env_file, or secrets: [NAME]"),
    "python-output-held-back": Code(
        WARNING, "What a program said before it crashed is lost.", 'environment: {PYTHONUNBUFFERED: "1"}'
    ),
    "unconfined": Code(WARNING, "Mistakes of the kernel can be used from inside.", "dropping it"),
    "requests-itself": Code(
        WARNING,
        "A request counts while its requester is wanted by another one.",
        "a request of developer, or always_on: true",
    ),
}
MACHINE = {
    "device-of-other-group": Code(
        WARNING, "The device is there, and may not be opened.", "its group, by number", machine=True
    ),
    "missing-host-path": Code(
        WARNING,
        "The engine makes an empty directory in its place, and the program fails unseen.",
        "creating it",
        machine=True,
    ),
    "missing-runtime": Code(
        WARNING, "The container cannot be made.", "installing it, or another runtime", machine=True
    ),
    "port-in-use": Code(
        WARNING,
        "The container cannot start while another program has the port.",
        "another port, or ending that program",
        machine=True,
    ),
    "limit-above-kernel": Code(
        WARNING,
        "The engine cannot give what it does not have itself.",
        "a smaller limit, or a higher one for the engine",
        machine=True,
    ),
    "more-than-machine": Code(WARNING, "It cannot be given on this machine.", "less of it", machine=True),
    "cgroup-version": Code(
        WARNING, "The kernel of this machine does not know that option.", "dropping it", machine=True
    ),
    "realtime-throttled": Code(
        WARNING,
        "Programs of real time are held back, or not let in at all.",
        "kernel.sched_rt_runtime_us as the kernel has it: 950000",
        machine=True,
    ),
}
