"""`rorg simulate` tells how short the CPU was."""

from __future__ import annotations

import json

import commands
import pytest
from busy_services import SERVICES
from robots import write_tree


@pytest.mark.slow
def test_the_command_tells_how_short_the_cpu_was(tmp_path):
    write_tree(tmp_path / "tree", SERVICES)
    spec = "{duration: 20s, events: [{at: 0s, request: burn, services: [burner]}]}"
    (tmp_path / "day.yaml").write_text(f"apiVersion: rorg/v1\nkind: Trace\nmetadata: {{name: day}}\nspec: {spec}\n")
    words = ["simulate", "day.yaml", "tree", "--cores", "2"]
    found = json.loads(commands.run([*words, "-o", "json"], cwd=tmp_path).stdout)["runs"][1]
    assert found["cpu"] == pytest.approx(2.0, abs=0.02)
    assert found["cpu_short"]["core_seconds"] == pytest.approx(20.0, abs=0.2)
    table = commands.run(words, cwd=tmp_path).stdout
    assert "CPU_SHORT" in table.splitlines()[0].replace(" ", "_")
    assert "core seconds" in table
    compared = commands.run([*words, "--compare", "linger=5s"], cwd=tmp_path).stdout
    assert "CPU_SHORT" in compared.splitlines()[0].replace(" ", "_")
