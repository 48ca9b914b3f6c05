"""Robots whose machine has too little memory or CPU."""

from __future__ import annotations

GIB = 1 << 30

POLICY = {"policy": {"budget": {"cpu": 2.0, "memory": "4Gi"}, "pressure": {"step": "500ms", "calm": "2s"}}}


def service(cpu: float, memory: str, priority: int, **more) -> dict:
    return {"resources": {"cpu": cpu, "memory": memory}, "priority": priority, **more}


BURN = [
    "python3",
    "-S",
    "-c",
    """
import os, signal, time
for number in (2, 15): signal.signal(number, lambda *_: os._exit(0))
hoard = bytearray(int(os.environ['HOARD']) << 20)
for i in range(0, len(hoard), 4096): hoard[i] = 1
share = float(os.environ['BURN'])
while True:
    end = time.monotonic() + 0.05 * share
    while time.monotonic() < end: pass
    time.sleep(0.05 * (1 - share))
""",
]
