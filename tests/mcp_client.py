"""A client of ``hiltest mcp``: the official one, over standard input and output of a server of its own."""

from __future__ import annotations

import os
import sys
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

Session = Any  # mcp.Client; the package may be missing
Answer = Any  # mcp.types.CallToolResult
Result = TypeVar("Result")


def ask(talk: Callable[[Session], Awaitable[Result]], folder: Path, *options: str) -> Result:
    """Start ``hiltest mcp`` in a folder, and return the result of a conversation with it."""
    import anyio
    from mcp.client.client import Client
    from mcp.client.stdio import StdioServerParameters, stdio_client

    environment = {name: value for name, value in os.environ.items() if not name.startswith("HIL_")}
    server = StdioServerParameters(
        command=sys.executable, args=["-P", "-m", "hiltest", "mcp", *options], env=environment, cwd=folder
    )

    async def converse() -> Result:
        async with Client(stdio_client(server)) as session:
            return await talk(session)

    return anyio.run(converse)
