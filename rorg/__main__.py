from rorg.cli.main import run

run()
