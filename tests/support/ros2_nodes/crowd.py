"""COUNT calls that wait for a service, and one that does not wait: crowd.py FILE COUNT SERVICE. The file tells for how
many seconds the last one waited for its answer, and how many of the others had theirs."""

import sys
import time

from caller import KINDS, Caller, stay, write

file, count, service = sys.argv[1:]
node = Caller("crowd")
node.brief("request", id="first", services=[service])
ask = [
    KINDS["request"].Request(caller=node.caller, id=f"n{n}", services=[service], wait=60.0) for n in range(int(count))
]
waits = [node.made["request"].call_async(request) for request in ask]
began = time.monotonic()
node.brief("query", name=service)
write(file, [time.monotonic() - began, sum(future.done() for future in waits)])
stay(node)
