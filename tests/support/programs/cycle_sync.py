"""For each service named on a line of its input: requests it, waits, says so; at the next line releases it."""

import sys

import rorg_client as rorg

client = rorg.Client(sys.argv[1], patience=60.0)
for line in sys.stdin:
    try:
        with client.request(line.strip(), wait=60.0):
            print("ready", flush=True)
            sys.stdin.readline()
        print("released", flush=True)
    except rorg.Error as error:
        print(f"error {error}", flush=True)
