"""Calls under another node's name: impostor.py FILE NAME ID SERVICE."""

import sys

from caller import Caller, stay, write

file, name, id, service = sys.argv[1:]
node = Caller("impostor", caller=name)
told = {
    "release": node.brief("release", id=id),
    "request": node.brief("request", id=id, services=[service]),
    "restart": node.brief("restart", name=service, force=True),
}
write(file, told)
stay(node)
