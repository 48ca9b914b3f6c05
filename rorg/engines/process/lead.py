"""Run as a program, becomes the shell that leads a run: `python lead.py /bin/sh -c ...`.

Before that it makes itself the parent of every process of the run that loses its own (PR_SET_CHILD_SUBREAPER, which
survives exec). So nothing leaves the leader's tree, neither by a double fork nor by a session of its own. Popen could
do this with preexec_fn, which can hang in a program with threads.

Then it waits for a byte on its standard input, which rorg sends when the run is on record. Without one, because rorg
was killed or the disk is full, the program never starts, so no run exists that the next rorg does not know.
"""

import ctypes
import os
import signal
import sys

PR_SET_CHILD_SUBREAPER = 36

if __name__ == "__main__":
    ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    for number in (signal.SIGPIPE, signal.SIGXFSZ):  # Python ignores these, and programs inherit that
        signal.signal(number, signal.SIG_DFL)
    if not os.read(0, 1):
        sys.exit(0)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.execv(sys.argv[1], sys.argv[1:])
