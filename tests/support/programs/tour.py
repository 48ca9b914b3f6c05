"""A behaviour in Python, as clients/cpp/examples/tour.cpp: tour.py DIRECTORY NAME=SERVICE,SERVICE..."""

import sys
import time
from pathlib import Path

import rorg.client as rorg

directory, held = Path(sys.argv[1]), None
for word in sys.argv[2:]:
    name, _, services = word.partition("=")
    request = rorg.request(*services.split(","), id="tour", reason=name, wait=60)
    if held:
        held.abandon()
    held = request
    (directory / f"ready-{name}").touch()
    while not (directory / f"next-{name}").exists():
        time.sleep(0.02)
held.release()
