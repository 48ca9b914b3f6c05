"""Commands in processes of their own that need not import everything first: each is a fork of this one.

`python command_server.py`, then on stdin one JSON list of words a line, or an object of `words`, `folder` and
`environment`; a JSON object of `code`, `out` and `err` for each on stdout."""

from __future__ import annotations

import gc
import json
import os
import sys
import tempfile

import rorg.api.server
import rorg.cli.alone
import rorg.cli.app
import rorg.cli.developing
import rorg.cli.main
import rorg.daemon.wiring
import rorg.engines.process.engine


def run(words: list[str], folder: str = ".", environment: dict[str, str] | None = None) -> dict[str, object]:
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        pid = os.fork()
        if pid == 0:
            code = 70
            try:
                os.dup2(out.fileno(), 1)
                os.dup2(err.fileno(), 2)
                os.chdir(folder)
                os.environ.update(environment or {})
                sys.argv = ["rorg", *words]
                rorg.cli.main.run()
                code = 0
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else int(end.code is not None)
            finally:
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code)
        code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        out.seek(0)
        err.seek(0)
        return {"code": code, "out": out.read(), "err": err.read()}


if __name__ == "__main__":
    rorg.cli.app.group()
    gc.freeze()
    nothing = os.open(os.devnull, os.O_RDONLY)
    lines = os.fdopen(os.dup(0), "r")
    os.dup2(nothing, 0)  # nobody can be asked
    for line in lines:
        told = json.loads(line)
        print(json.dumps(run(**told) if isinstance(told, dict) else run(told)), flush=True)
