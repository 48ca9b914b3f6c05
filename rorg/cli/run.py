"""rorg run"""

from __future__ import annotations

from rorg.cli.options import Directory, EngineName, StateDirectory


def command(directory: Directory = None, state_dir: StateDirectory = None, engine: EngineName = None) -> None:
    """Run the loop: keep the containers as the manifests and the requests file say, until stopped."""
    import os
    import signal
    import sys
    import time

    from rorg.cli.context import Context
    from rorg.cli.output import note
    from rorg.daemon.wiring import make_loop
    from rorg.errors import Invalid

    context = Context(state_dir, engine, directory, local=True)
    if not context.root.is_dir():
        raise Invalid(f"run {context.root}", "no such directory", "the directory that holds services/")
    context.state.acquire("rorg run")
    loop = make_loop(context.root, context.state, context.engine(),
                     lambda line: note(f"{time.strftime('%H:%M:%S')} {line}"))
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: loop.stop())
    note(f"rorg runs {context.root.resolve()} on {context.engine_name}, state in {context.state.path}; "
         "containers keep running when it stops")
    loop.run()
    context.state.release()
    if loop.hung:
        note(f"{len(loop.hung)} engine call(s) had not ended; the next rorg sees what came of them")
        sys.stderr.flush()
        os._exit(0)  # the interpreter would wait for their threads
