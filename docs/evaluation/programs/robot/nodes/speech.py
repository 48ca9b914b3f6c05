"""espeak-ng speaks what is published as /say. There is no loudspeaker: it computes the sound, and drops it."""

import subprocess

import rospy
from std_msgs.msg import String

rospy.init_node("speech")
rospy.Subscriber(
    "/say",
    String,
    lambda said: subprocess.run(["espeak-ng", "--stdout", said.data], stdout=subprocess.DEVNULL, check=True),
)
rospy.spin()
