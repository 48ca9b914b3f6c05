"""The table of codes as text, which is easier to read and to write than calls. A published code never changes.

It has what holds for all findings of a code. An entry is `CODE: why this is a finding`, and below it what to try, in
words that follow "try"; `to ...` is an instruction. (error): it can never work, and the tree is refused. (hint): shown
only by `rorg validate --hints`. Other codes are warnings. (once): shown at its first place, with the number of others.
(machine): found only by `rorg validate --machine`. table_of_containers.py has the second part.
"""

TEXT = r"""
# Form
duplicate-key (error): One of the two silently wins.
  try to drop one
empty-document (error): An empty file was most likely cut off.
  try to fill it, or delete the file
allow-without-reason: Next year's reader must know why the exception is right.
  try a reason behind the code
allow-unknown-code: A comment with a misspelt code has no effect.
  try a code of this page
allow-without-effect: The finding that it allowed is gone, or on another line.
  try to drop the comment
# Networks
ports-with-host-network (error): On the host's network there is nothing to publish: all ports are the host's own.
  try network_mode: bridge, or drop it
sysctls-with-host-network (error): The engine refuses these, because they belong to the host there.
  try to set it on the host, or use another network_mode
hostname-with-host-network (error): On the host's network, nothing can resolve that name. A ROS master ends with "unable
  to contact my own server".
  try to drop it, or set ROS_HOSTNAME: localhost
mixed-networks: ROS gives nodes the addresses of the others: across networks topics are listed, but no data arrives.
  try network_mode: host for all of them
ros-without-network: ROS uses the network even on a single machine.
  try network_mode: host
ros-master-uri (error): ROS programs fail to start with it.
  try http://localhost:11311
ros-ip-and-hostname: ROS takes ROS_HOSTNAME and ignores ROS_IP.
  try to drop one of them
ros-master-elsewhere: The nodes register elsewhere under a name that means that other machine itself: it cannot call
  them back.
  try ROS_IP with this machine's address, and no ROS_HOSTNAME
ros-masters-differ: Nodes at different masters do not see each other.
  try one ROS_MASTER_URI for all
ros2-local-on-bridge: On its own network, a container counts as another machine.
  try network_mode: host
port-taken-twice: The second one cannot start.
  try another port, or conflicts between the two
port-probed-twice: Whichever is up first makes the other one count as ready.
  try another port, or conflicts between the two
service-name-on-host-network: Only the networks of the engine resolve the names of services.
  try localhost, or the address of another machine
ros-address: A node tells all others this address, and they call it there.
  try the address of this machine
# Stopping
engine-restart-policy: A service that rorg has stopped comes back when the engine restarts.
  try to drop it; spec.restart says the same to rorg
sigterm-with-cpp-node: A roscpp node does not unregister on SIGTERM. As PID 1 it does not even end: it takes 10 s, exits
  with 137, and leaves a stale registration.
  try stop_signal: SIGINT with init: true, as the profile common has them
stop-by-kill: The program cannot close, save or unregister anything.
  try stop_signal: SIGINT
shell-without-exec: The signal reaches the shell, not its program.
  try exec before the last program
shell-form-command: The shell is PID 1 and does not pass the signal on: the program is killed after the grace period.
  try CMD ["program", "argument"] in the Dockerfile
grace-too-short: It is killed before it has unregistered from the master.
  try stop_grace_period: 5s
# Idle services
pause-of-infrastructure (error): Everything that talks to it would hang.
  try idle: {action: stop}
pause-of-actuator-consumer: A resumed subscriber receives its whole backlog: commands up to half a minute old.
  try idle: {action: stop}, or {action: pause, connected: stop}
duplicate-node-name: A paused node shuts down when it resumes and another node has taken its name.
  try idle: {action: stop}, or another node name
conflict-not-declared: ROS shuts down the first of two nodes with the same name.
  try conflicts
pause-of-ros-service: A call to a paused node does not fail. It hangs until the node resumes.
  try idle: {action: stop}
pause-of-server: The kernel keeps accepting connections for a paused program: callers do not fail, they wait.
  try idle: {action: stop}
pause-of-latched-publisher: Late subscribers never receive the map or the transform from a paused publisher.
  try idle: {action: stop}, or {action: pause, connected: stop}, or needs of those that use it
connected-without-pause: `connected` says what to do instead of a pause, but this service is never paused.
  try idle: {action: pause, connected: stop}
prewarm-without-effect: rorg starts a service only when something requests or needs it. A later version refuses the key.
  try to drop it
pause-of-ros2-node (once): DDS gives up a node 20 s after the pause. Its name does not come back, and calls are
  lost.
  try idle: {action: stop}, or {action: pause, connected: stop}, or escalate after at most 20s
pause-with-healthcheck: The engine also probes paused containers, and calls them unhealthy.
  try `ready` and `live`, which rorg asks only of what runs
ready-after-its-timeout: Every start counts as late.
  try a longer timeout
linger-shorter-than-start: A request a little later waits for a whole start.
  try a longer linger
# ROS 1
second-master: The second ROS master at the same address ends immediately.
  try to drop one
ros1-without-roscore (once): It may start before its master, and does not restart with it.
  try profile: ros1
ros-parameter-twice: A ROS master keeps one value per name: the one from the service that started last.
  try to declare it in a service that both need
need-without-restart (once): A node that outlives its master never returns to the graph.
  try profile: ros1
roslaunch-without-wait: If it finds no ROS master it starts its own, and other nodes then use that.
  try --wait
needed-without-ready: Without `ready`, a service counts as ready as soon as its process exists.
  try ready: {tcp: PORT}
sim-time-without-clock: All clocks stay at 0, and every timed wait lasts forever.
  try use_sim_time: false, or the service that publishes /clock
hidden-dependency: It runs without the service that it uses, and then hangs or fails.
  try needs
# ROS 2
ros2-host-net-private-ipc: Fast DDS uses shared memory for peers with the same address: 0 of 50 messages arrive.
  try ipc: host, or profile: ros2
ros2-mixed-uid: One user cannot open the other's shared memory: 0 of 50 messages arrive.
  try one user for all of them
ros2-domain-mismatch: Participants in different domains do not find each other: 0 of 50 messages arrive.
  try profile: ros2 for all of them
ros2-graph-unreported: rorg has no ROS 2 of its own. Without a node that reports the graph, these probes never answer.
  try the node of clients/ros2 as a service with `may_report_graph: true`
ros2-only (error): A ROS 1 master knows neither rates nor life cycles, and its programs have no such arguments.
  try profile: ros2, if it is a program of ROS 2
ros2-domain-range: Above 232 there are no ports; 102 to 214 collide with the ports of outgoing connections.
  try 0 to 101
ros2-rmw-mismatch: Two DDS implementations may not understand each other; Zenoh and DDS never do.
  try profile: ros2 for all of them
ros2-release-mismatch: Humble and later releases limit themselves to this machine in different ways: 0 of 50 messages
  arrive.
  try one release for all of them
ros2-discovery-mismatch: Other machines find only some of them, or they do not find each other.
  try the same for all of them
ros2-daemon: The daemon remembers nodes that no longer exist, and is killed with the container.
  try --no-daemon
misspelt-rmw: Every ROS 2 program ends immediately.
  try rmw_fastrtps_cpp
shm-too-small: A participant without shared memory dies of SIGBUS, or sends nothing.
  try shm_size: 256Mi
zenoh-without-router: Without a router, nodes of Zenoh do not find each other.
  try a Service with ros2 run rmw_zenoh_cpp rmw_zenohd
rmw-not-in-image: Without its middleware, every ROS 2 program ends immediately.
  try rmw_fastrtps_cpp, or an image with the package of that middleware
ros2-local-with-remote-server: Nodes that are limited to their machine do not reach others.
  try ROS_LOCALHOST_ONLY: "0"
sim-time-in-some: Transforms and timers of two times never meet: messages count as too old.
  try use_sim_time:=true for all of them
shm-nearly-full (machine): A participant without shared memory dies of SIGBUS, or sends nothing.
  try `mount -o remount,size=50% /dev/shm`, or `purge_shm: true` in the Policy
"""
