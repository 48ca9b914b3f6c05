"""What rorg's nodes for ROS 1 and ROS 2 share: everything except ROS itself."""
