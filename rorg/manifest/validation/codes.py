"""The table of codes: what rorg finds in manifests beside mistakes of form. A code stays what it is once it is out."""

from __future__ import annotations

from collections.abc import Mapping

from rorg.manifest.validation import container_codes as container
from rorg.manifest.validation.code import ERROR, WARNING, Code

_FORM = {
    "duplicate-key": Code(ERROR, "One of both would be taken in silence, and nobody knows which.", "dropping one"),
    "empty-document": Code(
        ERROR, "A file that says nothing is most likely one that was cut off.", "filling it, or deleting the file"
    ),
    "allow-without-reason": Code(
        WARNING, "Who reads it in a year must know why it is right.", "a reason behind the code"
    ),
    "allow-unknown-code": Code(WARNING, "A comment with a misspelt code lets nothing pass.", "a code of this page"),
    "allow-without-effect": Code(
        WARNING, "What it let pass is gone, or stands in another line.", "dropping the comment"
    ),
}
_NETWORKS = {
    "ports-with-host-network": Code(
        ERROR,
        "On the host's network all ports are the host's already: none is published.",
        "network_mode: bridge, or dropping it",
    ),
    "sysctls-with-host-network": Code(
        ERROR,
        "The engine refuses it: these belong to the host there.",
        "setting it on the host, or another network_mode",
    ),
    "hostname-with-host-network": Code(
        ERROR,
        "On the host's network nobody can look that name up. A ROS master ends with "
        '"unable to contact my own server".',
        "dropping it, or ROS_HOSTNAME: localhost",
    ),
    "mixed-networks": Code(
        WARNING,
        "ROS tells every node the address of every other one: across networks topics are listed, and no data arrives.",
        "network_mode: host for all of them",
    ),
    "ros-without-network": Code(WARNING, "ROS talks over the network also on one machine.", "network_mode: host"),
    "ros-master-uri": Code(ERROR, "No ROS program begins with it.", "http://localhost:11311"),
    "ros-ip-and-hostname": Code(WARNING, "ROS takes ROS_HOSTNAME and ignores ROS_IP.", "dropping one of them"),
    "ros-master-elsewhere": Code(
        WARNING,
        "The nodes sign on at another machine by a name that means itself there: it cannot call them back.",
        "ROS_IP with this machine's address, and no ROS_HOSTNAME",
    ),
    "ros-masters-differ": Code(
        WARNING, "Nodes at different masters do not see each other.", "one ROS_MASTER_URI for all"
    ),
    "ros2-local-on-bridge": Code(
        WARNING, "On a network of its own a container is a machine of its own.", "network_mode: host"
    ),
    "port-taken-twice": Code(WARNING, "The second one cannot start.", "another port, or conflicts between the two"),
    "port-probed-twice": Code(
        WARNING,
        "The first one that is up makes the other one count as ready.",
        "another port, or conflicts between the two",
    ),
}
_STOPPING = {
    "engine-restart-policy": Code(
        WARNING,
        "A service that rorg has ceased comes back with the engine, unasked.",
        "dropping it; spec.restart says the same to rorg",
    ),
    "sigterm-with-cpp-node": Code(
        WARNING,
        "A node of roscpp does not sign off by SIGTERM; as the first process it does not "
        "even end: 10 s, exit code 137, a stale registration.",
        "stop_signal: SIGINT with init: true, as the profile common has them",
    ),
    "stop-by-kill": Code(WARNING, "Nothing is closed, saved or signed off.", "stop_signal: SIGINT"),
    "shell-without-exec": Code(
        WARNING, "The shell gets the signal and the exit code, not its program.", "exec before the last program"
    ),
    "shell-form-command": Code(
        WARNING,
        "The shell is the first process, and its program never hears of the signal: it is killed after its grace.",
        'CMD ["program", "argument"] in the Dockerfile',
    ),
    "grace-too-short": Code(WARNING, "It is killed before it has signed off at the master.", "stop_grace_period: 5s"),
}
_IDLE = {
    "pause-of-infrastructure": Code(ERROR, "All that talk to it would hang.", "idle: {action: stop}"),
    "pause-of-actuator-consumer": Code(
        WARNING,
        "A paused subscriber gets its whole backlog when it is resumed: commands up to half a minute old, at once.",
        "idle: {action: stop}, or {action: pause, connected: stop}",
    ),
    "duplicate-node-name": Code(
        WARNING,
        "A paused node ends when it is resumed and another one has its name.",
        "idle: {action: stop}, or another node name",
    ),
    "conflict-not-declared": Code(WARNING, "ROS ends the first of two nodes of one name.", "conflicts"),
    "pause-of-ros-service": Code(
        WARNING, "A call to a paused node does not fail: it hangs until it is resumed.", "idle: {action: stop}"
    ),
    "pause-of-server": Code(
        WARNING,
        "The kernel goes on taking connections of a paused program: callers do not fail, they wait.",
        "idle: {action: stop}",
    ),
    "pause-of-latched-publisher": Code(
        WARNING,
        "Who comes later never gets the map, or the transform, from a paused publisher.",
        "idle: {action: stop}, or {action: pause, connected: stop}, or needs of those that use it",
    ),
    "connected-without-pause": Code(
        WARNING,
        "What is done instead of a pause is said of a service that is never paused.",
        "idle: {action: pause, connected: stop}",
    ),
    "pause-with-healthcheck": Code(
        WARNING,
        "The engine asks paused containers too, and calls them unhealthy.",
        "`ready` and `live`, which rorg asks only of what runs",
    ),
    "ready-after-its-timeout": Code(WARNING, "It counts as late at every start.", "a longer timeout"),
    "linger-shorter-than-start": Code(
        WARNING, "Whoever asks a little later waits for a whole start.", "a longer linger"
    ),
}
_ROS1 = {
    "second-master": Code(WARNING, "The second ROS master at one address ends at once.", "dropping one"),
    "ros1-without-roscore": Code(
        WARNING, "It may start before its master, and is not started again with it.", "profile: ros1"
    ),
    "ros-parameter-twice": Code(
        WARNING,
        "A ROS master has one value for each name: that of the service that started last.",
        "declaring it in a service that both need",
    ),
    "need-without-restart": Code(
        WARNING, "A node that outlives its master is gone from the graph for ever.", "profile: ros1"
    ),
    "roslaunch-without-wait": Code(
        WARNING, "It starts a ROS master of its own where it finds none, which others then use.", "--wait"
    ),
    "needed-without-ready": Code(
        WARNING, "Without `ready` a service is ready when its process is there.", "ready: {tcp: PORT}"
    ),
    "sim-time-without-clock": Code(
        WARNING,
        "All clocks stand at 0, and every wait for a time lasts for ever.",
        "use_sim_time: false, or the service that publishes /clock",
    ),
    "hidden-dependency": Code(WARNING, "It starts and stops without what it uses, and then hangs or fails.", "needs"),
}
_ROS2 = {
    "ros2-host-net-private-ipc": Code(
        WARNING,
        "Fast DDS sends by shared memory to all that have the same address: 0 of 50 messages arrive.",
        "ipc: host, or profile: ros2",
    ),
    "ros2-mixed-uid": Code(
        WARNING,
        "Shared memory of one user is closed to the other: 0 of 50 messages arrive.",
        "one user for all of them",
    ),
    "ros2-domain-mismatch": Code(
        WARNING,
        "Participants of different domains do not find each other: 0 of 50 messages arrive.",
        "profile: ros2 for all of them",
    ),
    "ros2-domain-range": Code(
        WARNING,
        "Above 232 there are no ports; from 102 to 214 they are among those that Linux takes for connections.",
        "0 to 101",
    ),
    "ros2-rmw-mismatch": Code(
        WARNING,
        "Nothing guarantees that two implementations understand each other; Zenoh and DDS never do.",
        "profile: ros2 for all of them",
    ),
    "ros2-release-mismatch": Code(
        WARNING,
        "Humble and later releases stay within this machine in different ways: 0 of 50 messages arrive.",
        "one release for all of them",
    ),
    "ros2-discovery-mismatch": Code(
        WARNING,
        "Some are found from other machines and others are not, or they do not find each other.",
        "the same for all of them",
    ),
    "ros2-daemon": Code(
        WARNING, "The daemon remembers nodes that are gone, and is killed with the container.", "--no-daemon"
    ),
    "misspelt-rmw": Code(WARNING, "Every program of ROS 2 ends at once.", "rmw_fastrtps_cpp"),
    "shm-too-small": Code(
        WARNING, "A participant that gets no shared memory dies of SIGBUS, or sends nothing.", "shm_size: 256Mi"
    ),
    "shm-nearly-full": Code(
        WARNING,
        "A participant that gets no shared memory dies of SIGBUS, or sends nothing.",
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
