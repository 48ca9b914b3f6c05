"""Requests one service after another, writes down what came of it, and holds them: ask.py FILE NODE SERVICE..."""

import sys

from caller import Caller, stay, write

file, name, *services = sys.argv[1:]
node = Caller(name)
told = []
for service in services:
    open(file + ".asks", "w").close()
    told.append(node.brief("request", id=service, services=[service], wait=60.0))
write(file, told)
stay(node)
