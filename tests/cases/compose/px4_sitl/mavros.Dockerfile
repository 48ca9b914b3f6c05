FROM ros:noetic-ros-core
