"""The same with asyncio: two requests together, and a restart with a wait."""

from __future__ import annotations

import asyncio
import sys

import rorg_client as rorg


async def main(first: str, second: str) -> None:
    client = rorg.AsyncClient()
    losses: list[rorg.Loss] = []
    async with client.request(first, wait=30, on_lost=losses.append):
        held = await client.request(second)
        ready = held.ready(timeout=30)  # a task: do something else meanwhile
        print((await client.service(first))["health"])
        await ready
        await client.restart(second, wait=30)
        await held.release()
    print(f"{len(losses)} losses")
    await client.close()


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:3]))
