"""For each service named on a line of its input: requests it, waits, says so; at the next line releases it."""

import asyncio
import sys

import rorg_client as rorg


async def main(address: str) -> None:
    client, loop = rorg.AsyncClient(address, patience=60.0), asyncio.get_running_loop()

    async def line() -> str:
        return await loop.run_in_executor(None, sys.stdin.readline)

    while service := (await line()).strip():
        try:
            async with client.request(service, wait=60.0):
                print("ready", flush=True)
                await line()
            print("released", flush=True)
        except rorg.Error as error:
            print(f"error {error}", flush=True)


asyncio.run(main(sys.argv[1]))
