"""Services that need more CPU than there is."""

from __future__ import annotations

SERVICES = {
    "burner": {"resources": {"cpu": 3}, "container": {"cpu_shares": 2048}},
    "arm": {"resources": {"cpu": 0.1}, "ready": {"tcp": 80}, "idle": {"action": "stop", "linger": "0s"}},
}
