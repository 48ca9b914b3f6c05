"""Publishes the map of the room once, for all who subscribe later, too. Debian does not ship ROS's map_server."""

import rospy
from nav_msgs.msg import OccupancyGrid
from room import CELL, SIZE, room

rospy.init_node("map_server")
said = OccupancyGrid()
said.header.frame_id = "map"
said.info.resolution, said.info.width, said.info.height = CELL, SIZE, SIZE
said.data = [100 * int(cell) for cell in room().flat]
maps = rospy.Publisher("/map", OccupancyGrid, queue_size=1, latch=True)
maps.publish(said)
rospy.spin()
