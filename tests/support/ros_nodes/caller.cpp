// A ROS 1 node in C++ that requests the service of a node, and holds it: caller NODE.
#include <cstdio>

#include "ros/ros.h"
#include "rorg_ros/RequestServices.h"

int main(int argc, char** argv) {
  ros::init(argc, argv, "caller");
  ros::NodeHandle node;
  ros::service::waitForService("/rorg/request", 30000);
  rorg_ros::RequestServices call;
  call.request.id = "cpp";
  call.request.services.push_back(argv[1]);
  call.request.wait = 30;
  if (!ros::service::call("/rorg/request", call) || !call.response.success) {
    std::fprintf(stderr, "%s\n", call.response.message.c_str());
    return 1;
  }
  std::printf("%s\n", call.response.message.c_str());
  std::fflush(stdout);
  ros::spin();
}
