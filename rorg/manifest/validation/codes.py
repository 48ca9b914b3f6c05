"""The table of codes: what rorg finds in manifests beside mistakes of form. A code stays what it is once it is out."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.manifest.validation import container_codes as container
from rorg.manifest.validation.code import ERROR, WARNING, Code

_FORM = {
    "duplicate-key": Code(ERROR, "One of the two silently wins.", "dropping one"),
    "empty-document": Code(ERROR, "An empty file was most likely cut off.", "filling it, or deleting the file"),
    "allow-without-reason": Code(
        WARNING, "Next year's reader must know why the exception is right.", "a reason behind the code"
    ),
    "allow-unknown-code": Code(WARNING, "A comment with a misspelt code has no effect.", "a code of this page"),
    "allow-without-effect": Code(
        WARNING, "The finding that it allowed is gone, or on another line.", "dropping the comment"
    ),
}
_NETWORKS = {
    "ports-with-host-network": Code(
        ERROR,
        "On the host's network there is nothing to publish: all ports are the host's own.",
        "network_mode: bridge, or dropping it",
    ),
    "sysctls-with-host-network": Code(
        ERROR,
        "The engine refuses these, because they belong to the host there.",
        "setting it on the host, or another network_mode",
    ),
    "hostname-with-host-network": Code(
        ERROR,
        "On the host's network, nothing can resolve that name. A ROS master ends with "
        '"unable to contact my own server".',
        "dropping it, or ROS_HOSTNAME: localhost",
    ),
    "mixed-networks": Code(
        WARNING,
        "ROS gives nodes the addresses of the others: across networks topics are listed, but no data arrives.",
        "network_mode: host for all of them",
    ),
    "ros-without-network": Code(WARNING, "ROS uses the network even on a single machine.", "network_mode: host"),
    "ros-master-uri": Code(ERROR, "ROS programs fail to start with it.", "http://localhost:11311"),
    "ros-ip-and-hostname": Code(WARNING, "ROS takes ROS_HOSTNAME and ignores ROS_IP.", "dropping one of them"),
    "ros-master-elsewhere": Code(
        WARNING,
        "The nodes register elsewhere under a name that means that other machine itself: it cannot call them back.",
        "ROS_IP with this machine's address, and no ROS_HOSTNAME",
    ),
    "ros-masters-differ": Code(
        WARNING, "Nodes at different masters do not see each other.", "one ROS_MASTER_URI for all"
    ),
    "ros2-local-on-bridge": Code(
        WARNING, "On its own network, a container counts as another machine.", "network_mode: host"
    ),
    "port-taken-twice": Code(WARNING, "The second one cannot start.", "another port, or conflicts between the two"),
    "port-probed-twice": Code(
        WARNING,
        "Whichever is up first makes the other one count as ready.",
        "another port, or conflicts between the two",
    ),
}
_STOPPING = {
    "engine-restart-policy": Code(
        WARNING,
        "A service that rorg has stopped comes back when the engine restarts.",
        "dropping it; spec.restart says the same to rorg",
    ),
    "sigterm-with-cpp-node": Code(
        WARNING,
        "A roscpp node does not unregister on SIGTERM. As PID 1 it does not "
        "even end: it takes 10 s, exits with 137, and leaves a stale registration.",
        "stop_signal: SIGINT with init: true, as the profile common has them",
    ),
    "stop-by-kill": Code(WARNING, "The program cannot close, save or unregister anything.", "stop_signal: SIGINT"),
    "shell-without-exec": Code(
        WARNING, "The signal reaches the shell, not its program.", "exec before the last program"
    ),
    "shell-form-command": Code(
        WARNING,
        "The shell is PID 1 and does not pass the signal on: the program is killed after the grace period.",
        'CMD ["program", "argument"] in the Dockerfile',
    ),
    "grace-too-short": Code(
        WARNING, "It is killed before it has unregistered from the master.", "stop_grace_period: 5s"
    ),
}
_IDLE = {
    "pause-of-infrastructure": Code(ERROR, "Everything that talks to it would hang.", "idle: {action: stop}"),
    "pause-of-actuator-consumer": Code(
        WARNING,
        "A resumed subscriber receives its whole backlog at once: commands up to half a minute old.",
        "idle: {action: stop}, or {action: pause, connected: stop}",
    ),
    "duplicate-node-name": Code(
        WARNING,
        "A paused node shuts down when it resumes and another node has taken its name.",
        "idle: {action: stop}, or another node name",
    ),
    "conflict-not-declared": Code(WARNING, "ROS shuts down the first of two nodes with the same name.", "conflicts"),
    "pause-of-ros-service": Code(
        WARNING, "A call to a paused node does not fail. It hangs until the node resumes.", "idle: {action: stop}"
    ),
    "pause-of-server": Code(
        WARNING,
        "The kernel keeps accepting connections for a paused program: callers do not fail, they wait.",
        "idle: {action: stop}",
    ),
    "pause-of-latched-publisher": Code(
        WARNING,
        "Late subscribers never receive the map or the transform from a paused publisher.",
        "idle: {action: stop}, or {action: pause, connected: stop}, or needs of those that use it",
    ),
    "connected-without-pause": Code(
        WARNING,
        "`connected` says what to do instead of a pause, but this service is never paused.",
        "idle: {action: pause, connected: stop}",
    ),
    "pause-with-healthcheck": Code(
        WARNING,
        "The engine also probes paused containers, and calls them unhealthy.",
        "`ready` and `live`, which rorg asks only of what runs",
    ),
    "ready-after-its-timeout": Code(WARNING, "Every start counts as late.", "a longer timeout"),
    "linger-shorter-than-start": Code(WARNING, "A request a little later waits for a whole start.", "a longer linger"),
}
_ROS1 = {
    "second-master": Code(WARNING, "The second ROS master at the same address ends immediately.", "dropping one"),
    "ros1-without-roscore": Code(
        WARNING, "It may start before its master, and does not restart with it.", "profile: ros1"
    ),
    "ros-parameter-twice": Code(
        WARNING,
        "A ROS master keeps one value per name: the one from the service that started last.",
        "declaring it in a service that both need",
    ),
    "need-without-restart": Code(
        WARNING, "A node that outlives its master never returns to the graph.", "profile: ros1"
    ),
    "roslaunch-without-wait": Code(
        WARNING, "If it finds no ROS master it starts its own, and other nodes then use that.", "--wait"
    ),
    "needed-without-ready": Code(
        WARNING, "Without `ready`, a service counts as ready as soon as its process exists.", "ready: {tcp: PORT}"
    ),
    "sim-time-without-clock": Code(
        WARNING,
        "All clocks stay at 0, and every timed wait lasts forever.",
        "use_sim_time: false, or the service that publishes /clock",
    ),
    "hidden-dependency": Code(WARNING, "It runs without the service that it uses, and then hangs or fails.", "needs"),
}
_ROS2 = {
    "ros2-host-net-private-ipc": Code(
        WARNING,
        "Fast DDS uses shared memory for peers with the same address: 0 of 50 messages arrive.",
        "ipc: host, or profile: ros2",
    ),
    "ros2-mixed-uid": Code(
        WARNING,
        "One user cannot open the other's shared memory: 0 of 50 messages arrive.",
        "one user for all of them",
    ),
    "ros2-domain-mismatch": Code(
        WARNING,
        "Participants in different domains do not find each other: 0 of 50 messages arrive.",
        "profile: ros2 for all of them",
    ),
    "ros1-probe-of-ros2": Code(
        ERROR,
        "No ROS 1 master knows a ROS 2 program. The one that answers on this machine may be another robot's.",
        "a tcp, file, log or exec probe; or ROS_MASTER_URI in its environment, if it bridges to ROS 1",
    ),
    "ros2-domain-range": Code(
        WARNING,
        "Above 232 there are no ports; 102 to 214 collide with the ports of outgoing connections.",
        "0 to 101",
    ),
    "ros2-rmw-mismatch": Code(
        WARNING,
        "Two DDS implementations may not understand each other; Zenoh and DDS never do.",
        "profile: ros2 for all of them",
    ),
    "ros2-release-mismatch": Code(
        WARNING,
        "Humble and later releases limit themselves to this machine in different ways: 0 of 50 messages arrive.",
        "one release for all of them",
    ),
    "ros2-discovery-mismatch": Code(
        WARNING,
        "Other machines find only some of them, or they do not find each other.",
        "the same for all of them",
    ),
    "ros2-daemon": Code(
        WARNING, "The daemon remembers nodes that no longer exist, and is killed with the container.", "--no-daemon"
    ),
    "misspelt-rmw": Code(WARNING, "Every ROS 2 program ends immediately.", "rmw_fastrtps_cpp"),
    "shm-too-small": Code(
        WARNING, "A participant without shared memory dies of SIGBUS, or sends nothing.", "shm_size: 256Mi"
    ),
    "shm-nearly-full": Code(
        WARNING,
        "A participant without shared memory dies of SIGBUS, or sends nothing.",
        "`mount -o remount,size=50% /dev/shm`, or removing what fills it",
        machine=True,
    ),
}

TABLE: Mapping[str, Mapping[str, Code]] = {
    "Form": _FORM,
    "Networks": _NETWORKS,
    "Stopping": _STOPPING,
    "Idle services": _IDLE,
    "ROS 1": _ROS1,
    "ROS 2": _ROS2,
    "Devices": container.DEVICES,
    "Mounts and commands": container.MOUNTS,
    "Limits and logs": container.LIMITS,
    "Programs": container.PROGRAMS,
    "The machine": container.MACHINE,
}
"""By family, as the reference page has them."""
CODES: Mapping[str, Code] = {name: code for family in TABLE.values() for name, code in family.items()}
