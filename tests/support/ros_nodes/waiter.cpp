// A ROS 1 node in C++ that waits, as roscpp's own main loop does: waiter NAME.
#include "ros/ros.h"

int main(int argc, char** argv) {
  ros::init(argc, argv, argv[1]);
  ros::NodeHandle node;
  ros::spin();
}
