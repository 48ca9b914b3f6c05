"""The second part of the table of codes: what containers get and run. table.py describes the form."""

TEXT = r"""
# Devices
privileged: One mistake in it, or one attack on it, reaches the whole machine.
  try driver: {devices, groups, realtime}, which give what is needed
sys-admin: It lets a container mount the machine's disks.
  try the one capability that is needed
whole-dev-mounted: It reaches all disks, and the machine's /dev/shm too.
  try driver: {devices: [...]}
unstable-device-path: The kernel numbers these in the order in which it finds them.
  try /dev/serial/by-id/...
missing-device (machine): The container cannot start, nor start again after an unplug.
  try to plug it in, or use its name in /dev/serial/by-id
device-as-volume: Opening it fails with "operation not permitted", even for root.
  try driver: {devices: [...]}
device-shared: Two programs on one port each get half of the data.
  try conflicts between the two
device-without-group: The device exists, but the program may not open it.
  try driver: {groups: [dialout]}
device-not-given: The program cannot open it.
  try driver: {devices: [...]}
program-without-device: The program ends, or waits forever.
  try driver: {devices: [...]}
misspelt-group: The engine refuses to start a container with an unknown group.
  try its right name
group-not-in-image: The engine refuses to start a container with an unknown group.
  try the group's number on this machine (`getent group NAME`)
can-without-host-network: The interface of a CAN bus is part of the host's network.
  try network_mode: host
realtime-without-sys-nice (hint): The limit allows SCHED_FIFO and SCHED_RR. Only SYS_NICE allows a negative nice value,
  a higher priority than the limit, and changes of other users' processes.
  try driver: {realtime: true}
sys-nice-without-rtprio: Only root's programs keep capabilities; others have only limits.
  try driver: {realtime: true}
display-without-x11: It ends when it opens its first window.
  try volumes: ["/tmp/.X11-unix:/tmp/.X11-unix:ro"]
window-without-display: It ends when it opens its first window.
  try profile: x11
file-not-mounted: Programs end, or silently use their defaults.
  try a volume for it
x11-private-ipc: X11 programs show black windows or end with BadAccess: the server cannot read their shared memory.
  try environment: {QT_X11_NO_MITSHM: "1"}, as the profile x11 has it, or ipc: host
gpu-variables-without-gpu: Without a GPU, the variable has no effect.
  try gpus: all
gpu-without-graphics: OpenGL falls back to the CPU, or fails.
  try NVIDIA_DRIVER_CAPABILITIES: all, or profile: gpu
gpu-without-runtime (machine): Without it, the engine cannot create the container on this machine.
  try the NVIDIA container toolkit
# Mounts and commands
socket-file-mounted (error): A mounted socket file is dead once its program restarts.
  try its directory
engine-socket-mounted: A program that can talk to the engine can mount the whole machine.
  try may_request or may_manage, by which rorg does it
missing-mount-source: The engine creates an empty directory instead, and the program fails silently.
  try to create it
mount-not-writable (machine): Its logs, bags or maps are lost.
  try another owner of the directory
mount-over-system: The image's own programs disappear.
  try a directory of its own inside
mount-over-workspace: ROS does not find the packages, or the container ends with "setup.bash: no such file".
  try a mount below src only
whole-host-mounted: A mistake in it deletes the machine's files.
  try the one directory, or :ro
missing-file: The program ends immediately, at every start.
  try to create it
program-not-executable: The container cannot start: permission denied.
  try chmod +x
script-with-crlf: The container cannot start: no such file or directory.
  try line ends of Unix
shell-words-without-shell: rorg splits a command into words and runs no shell.
  try command: [bash, -c, "..."] with exec before the last program
program-in-background: The container keeps running and counts as ready when half of it is gone.
  try a Service of its own for each program
shell-without-terminal: The shell finds no input and ends; rorg starts it again and again.
  try command: sleep infinity, or tty: true and stdin_open: true
sudo-without-privileges: The command fails immediately.
  try user: root, and no sudo
command-in-one-word: The container cannot start: no such file or directory.
  try one word per item, or one text without brackets
script-not-quoted: The shell takes only the first word behind -c as its script.
  try bash -c "...", with quotes around all of it
source-in-sh: Programs of ROS are not found.
  try bash instead of sh
launch-file-of-ros2: The program ends immediately.
  try ros2 launch, or a launch file of ROS 1
ros-args-missing: The node runs with its defaults, if it does not read its arguments itself.
  try --ros-args before it
turtlebot3-without-model: The launch file ends with KeyError, or finds no robot description.
  try environment: {TURTLEBOT3_MODEL: burger}
keyboard-without-terminal: It ends with "Inappropriate ioctl for device".
  try tty: true and stdin_open: true
# Limits and logs
limit-below-expected: It is killed or slowed down during normal work.
  try a higher limit
always-on-over-budget: The machine is overloaded before anything is requested.
  try fewer services that are always on
budget-without-resources: rorg admits it regardless of what else runs.
  try resources: {cpu: 0.5, memory: 100Mi}
read-only-ros: It ends immediately, because it cannot create a log directory.
  try tmpfs: [/tmp], with ROS_LOG_DIR: /tmp/ros
user-without-home: It ends immediately, because it cannot create the directory /.ros.
  try environment: {ROS_HOME: /tmp/ros}, or HOME
log-without-limits (once): A full disk stops everything.
  try logging: {driver: json-file, options: {max-size: 10m, max-file: "3"}}
recording-without-limit: A full disk stops everything.
  try --split --size=1024 --max-splits=20
recording-outside-mounts: The recording is gone when the container is replaced.
  try volumes: ["bags:/bags"], and -o /bags/NAME
shm-above-mem-limit: Shared memory counts as memory of the container.
  try a larger mem_limit, or a smaller shm_size
tty-without-stdin (hint): Programs format their output for a terminal that is not there.
  try stdin_open: true, or drop tty
shm-size-with-ipc-host (hint): The engine ignores it.
  try to drop one of them
oom-kill-disabled-without-limit: The kernel kills everything else first.
  try mem_limit
nofile-too-high: Python closes every possible descriptor up to the limit, one by one.
  try nofile: {soft: 1024, hard: 524288}
time-zones-differ: You cannot compare times in the logs.
  try one TZ, in a profile
# Programs
latest-tag (once): A rollback cannot find the earlier image.
  try a tag with a version, or a digest
ros-version-of-image: The program is missing, and the container ends immediately.
  try an image of the other ROS
ros-entrypoint-replaced: The ROS programs are not on the path.
  try /ros_entrypoint.sh as the first word of the entry point
misspelt-image: The image does not exist, and the service waits forever.
  try the Image's name
misspelt-variable: A misspelt variable silently has no effect.
  try its right name
quoted-variable: The program gets the quotes too: no number, no address, no file.
  try to drop the quotes
costly-probe: A dozen of these use a whole core.
  try ros_node, ros_topic or ros_service, which cost 2 ms
ready-without-healthcheck: It never becomes ready.
  try a healthcheck, or another form of `ready`
log-probe-without-log: It never becomes ready.
  try another logging driver, or another form of `ready`
probe-port-swapped: It never becomes ready.
  try the port of the command
sleep-as-readiness: The sleep is too short on a slow day, and too long on all others.
  try needs, and `ready` on what it waits for
secret-in-manifest: Everyone who can read the repository can read it.
  try env_file, or secrets: [NAME]
python-output-held-back (once): The last output before a crash is lost.
  try environment: {PYTHONUNBUFFERED: "1"}
unconfined: The container can exploit kernel bugs that the profile blocks.
  try to drop it
requests-itself: A request counts only while something else wants its requester.
  try a request of developer, or always_on: true
# Any machine
not-on-swarm (error): Docker Swarm cannot do it, and would leave it out without a word.
  try machine: NAME, or drop it
exclusive-anywhere (error): While its network is split, a Swarm may run a service twice.
  try machine: NAME
volume-of-one-node (error): On another node the service would find an empty volume of the same name.
  try machine: NAME, or a path of a file system that all nodes share
tree-of-one-node (error): Only files in `mounts` travel with a service.
  try mounts: [./dir:/path/in/container]
path-of-node: Where it is missing, the Swarm rejects the task and tries again without end.
  try mounts, for configuration; else placement, for the nodes that have it
image-of-one-node (error): The other nodes have no such image, and the Swarm builds none.
  try the name of an image in a registry, or machine: NAME
# The machine
device-of-other-group (machine): The device exists, but the program may not open it.
  try its group, by number
missing-host-path (machine): The engine creates an empty directory instead, and the program fails silently.
  try to create it
missing-runtime (machine): The engine cannot create the container.
  try to install it, or use another runtime
port-in-use (machine): The container cannot start while another program has the port.
  try another port, or end that program
limit-above-kernel (machine): The engine cannot grant more than it has itself.
  try a smaller limit, or a higher one for the engine
more-than-machine (machine): This machine does not have that much.
  try less of it
engine-lacks (machine): The engine ignores or refuses it, or rorg does something else instead.
  try another engine, or drop it
cgroup-version (machine): This machine's kernel does not support that option.
  try to drop it
realtime-throttled (machine): Real-time programs are throttled or refused.
  try kernel.sched_rt_runtime_us as the kernel has it: 950000
"""
