"""python -m rorg"""

from rorg.cli.main import run

run()
