"""What the how-tos need before their first command."""

from __future__ import annotations

import pages

PREPARE = f"""set -e
trap 'echo "{pages.SAID}failed"' ERR
trap 'rorg dev --stop || true; rorg down --yes; wait' EXIT
git config --global user.name you
git config --global user.email you@localhost
exec 2>&1
"""
