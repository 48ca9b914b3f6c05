"""A behaviour that uses all of rorg's services, writes down what they said, and goes on: behaviour.py FILE."""

import sys

import rclpy
from caller import Caller, stay, write
from rclpy.qos import DurabilityPolicy, QoSProfile
from rorg_ros2_interfaces.msg import Status

TEXT = """apiVersion: rorg/v1
kind: Service
metadata: {name: lab-radio}
spec: {image: rorg-base, command: [sleep, "600"]}
"""
node, seen = Caller("behaviour"), []
told = {"request": node.brief("request", id="look", services=["/camera"], reason="to see", wait=30.0)}
found = node.call("query", name="/camera")
told["query"] = [found.success, found.status.name, found.status.health]
told["forbidden"] = node.brief("request", id="other", services=["arm"])
told["endless"] = node.brief("request", id="other", services=["camera"], ttl=float("inf"))
told["second"] = node.brief("request", id="brief", services=["camera"])
told["release"] = node.brief("release", id="brief")
told["release_again"] = node.brief("release", id="brief")
told["restart"] = node.brief("restart", name="camera")
told["restart_arm"] = node.brief("restart", name="arm")
told["put"] = node.brief("put_manifest", name="lab-radio", text=TEXT)
told["put_other"] = node.brief("put_manifest", name="radio", text=TEXT.replace("lab-radio", "radio"))
got = node.call("get_manifest", name="lab-radio")
told["get"] = [got.success, got.text == TEXT]
told["put_stale"] = node.brief("put_manifest", name="lab-radio", text=TEXT, base="0" * len(got.digest))
told["put_again"] = node.brief("put_manifest", name="lab-radio", text=TEXT.replace("600", "500"), base=got.digest)
told["remove_stale"] = node.brief("remove_manifest", name="lab-radio", base=got.digest)
told["remove"] = node.brief("remove_manifest", name="lab-radio")
told["get_removed"] = node.brief("get_manifest", name="lab-radio")
latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
node.create_subscription(Status, "/rorg/status", seen.append, latched)
while not seen:
    rclpy.spin_once(node)
told["status"] = [service.name for service in seen[0].services]
write(sys.argv[1], told)
stay(node)
