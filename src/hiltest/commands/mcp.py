"""``hiltest mcp``: commands of hiltest as tools of a coding agent, by the Model Context Protocol over stdio.

A tool is a command: its parameters are those of the command line, its answer is the document of ``--json``. Each call
is a process of its own, which can be stopped and cannot write to the protocol's output.
"""

from __future__ import annotations

import contextlib
import inspect
import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hiltest.commands.options import seed_range, setting_option
from hiltest.errors import ConfigError
from hiltest.session.settings import DEFAULT_OUT, make_folder

if TYPE_CHECKING:
    from anyio.abc import ByteReceiveStream, Process
    from mcp.types import CallToolRequestParams, CallToolResult, ListToolsResult, Tool

TOOLS = ("run", "compare", "explain", "profile", "judge", "fit")
# These write elsewhere than below --out, address a board or another host, go to pytest, or only change printed text.
_LEFT_OUT = {
    "run": {"port", "flash", "jobs", "coverage", "record", "verbose", "pytest_args", "page", "host", "serial"},
    "profile": {"folded", "flame_graph", "lines", "instructions"},
    "judge": {"init"},
    "fit": {"export_json", "export_header", "export_ardupilot", "force", "html"},
}
_TERMINAL_HELP = " ELF is the same as"  # begin of the help on arguments that no tool has
_INSTRUCTIONS = """hiltest measures compass firmware on a virtual board: heading errors and cycles.
run measures the build in its parameter firmware, judges it, and writes the record to the folder {out}/OUT.
Without suite=full a run leaves out tests of the full set; the key tests_left_out of its answer is their number.
explain names the cause of that record's verdict, and the source lines that cost more than in its base.
compare lists the changes between two records, and profile the cycles of one function by source line.
judge measures a calibrator or filter from a file, and fit evaluates a recorded log.
Firmware with its own output needs a rig, which hiltest start proposes at a terminal.
Names of files and folders are relative to {folder}."""
ANSWER_BYTES = 16 * 1024  # some six thousand tokens; common agents refuse answers of more than 25 000
_JSON = "as_json"
_AT_ONCE = 2
_MOST_SEEDS = 100  # at the default time limit six seconds each
_GRACE_S = 1.0  # a client waits two seconds for the end of the server before it kills it
_LAST_ERRORS = 64 * 1024
_INTERRUPTED = 2
_EXIT_CODES = """
\b
Exit codes:
  0   the client closed the connection
  2   interrupted, or ended by SIGTERM
  4   usage: an option is wrong, or the package mcp is missing
"""


@click.command(epilog=_EXIT_CODES)
@setting_option("out", default=DEFAULT_OUT, help="Write everything that tools write below this folder.")
@click.option(
    "--timeout",
    "timeout_s",
    metavar="S",
    type=click.IntRange(1, 86_400),
    default=600,
    show_default=True,
    help="Stop a tool that takes longer than this, in seconds.",
)
def mcp(out: Path, timeout_s: int) -> None:
    """Serve the tools of hiltest to a coding agent, by MCP.

    The tools are the commands run, compare, explain, profile, judge and fit. Standard input and output belong to the
    protocol.
    """
    try:
        import anyio
        import mcp as _package  # noqa: F401
    except ImportError as error:
        raise ConfigError(f"hiltest mcp needs the package mcp ({error}): pip install 'hiltest[mcp]'") from error
    make_folder(out)
    anyio.run(_Tools(out.resolve(), timeout_s).serve)


class _Tools:
    """The tools of one server, which write below `out`, an absolute path without links."""

    def __init__(self, out: Path, timeout_s: int) -> None:
        from hiltest.commands.cli import every_command

        self._out, self._timeout_s = out, timeout_s
        self._running: set[Process] = set()
        self._commands = {name: command for name, command in every_command() if name in TOOLS}

    async def serve(self) -> None:
        """Serve one client until it closes standard input."""
        import anyio
        from mcp.server.lowlevel import Server
        from mcp.server.stdio import stdio_server

        from hiltest import __version__

        self._limiter = anyio.CapacityLimiter(_AT_ONCE)
        instructions = _INSTRUCTIONS.format(out=self._named(self._out), folder=Path.cwd())
        server = Server(
            "hiltest",
            version=__version__,
            instructions=instructions,
            on_list_tools=self._list,
            on_call_tool=self._call,
        )
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._end)
        async with stdio_server() as (messages, answers):
            await server.run(messages, answers, server.create_initialization_options())

    def _end(self, *_: object) -> NoReturn:
        """End all commands and this process at once: a thread that waits for standard input cannot be cancelled."""
        for process in self._running:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
        os._exit(_INTERRUPTED)

    async def _list(self, _context: object, _page: object) -> ListToolsResult:
        from mcp.types import ListToolsResult

        return ListToolsResult(tools=[self._tool(name) for name in TOOLS])

    def _tool(self, name: str) -> Tool:
        from mcp.types import Tool, ToolAnnotations

        command, parameters = self._commands[name], self._parameters(name)
        context = click.Context(command)
        helps = [str(option.get_help_record(context)) for option in command.params if option.name == _JSON]
        schemas = re.findall(r"hiltest\.[a-z-]+/\d+", helps[0])
        properties = {key: _schema(parameter) for key, parameter in parameters.items()}
        if writes := "out" in parameters:
            out = self._named(self._out)
            properties["out"]["description"] = f"Write to the folder {out}/OUT, which other tools read by that name."
        description = inspect.cleandoc(command.help or "").partition(_TERMINAL_HELP)[0]
        return Tool(
            name=name,
            description=f"{description}\n\nFile names are relative to {Path.cwd()}.",
            input_schema={
                "type": "object",
                "properties": properties,
                "required": [key for key, parameter in parameters.items() if parameter.required],
                "additionalProperties": False,
            },
            output_schema={"type": "object", "properties": {"schema": {"enum": schemas}}, "required": ["schema"]},
            annotations=ToolAnnotations(read_only_hint=not writes, open_world_hint=False),
        )

    @staticmethod
    def _named(folder: Path) -> str:
        """Return the name by which a tool reads a folder."""
        here = Path.cwd()
        return str(folder.relative_to(here) if folder.is_relative_to(here) else folder)

    def _parameters(self, name: str) -> dict[str, click.Parameter]:
        left_out = _LEFT_OUT.get(name, set()) | {_JSON}
        parameters = (parameter for parameter in self._commands[name].params if parameter.name not in left_out)
        return {max(parameter.opts, key=len).lstrip("-"): parameter for parameter in parameters}

    async def _call(self, _context: object, call: CallToolRequestParams) -> CallToolResult:
        """Run a command; an error is an answer with its sentence."""
        from mcp.types import CallToolResult, TextContent

        from hiltest.short_documents import compact, shorten

        try:
            words = self._command_line(call.name, call.arguments or {})
            async with self._limiter:
                document = shorten(await self._document(words), ANSWER_BYTES)
        except ConfigError as error:
            return CallToolResult(content=[TextContent(text=str(error))], is_error=True)
        is_error = document["schema"].startswith("hiltest.error/")
        text = document["message"] if is_error else compact(document)
        return CallToolResult(content=[TextContent(text=text)], structured_content=document, is_error=is_error)

    def _command_line(self, name: str, arguments: Mapping[str, Any]) -> list[str]:
        """Return a command line, whose command checks the values; refuse unknown names and folders elsewhere."""
        from hiltest.budgets import TOOL_CALL, BudgetError
        from hiltest.short_documents import compact

        if name not in TOOLS:
            raise ConfigError(f"no tool {name!r}; the tools are {', '.join(TOOLS)}")
        parameters = self._parameters(name)
        if unknown := sorted(arguments.keys() - parameters.keys()):
            raise ConfigError(f"{name}: no parameter {unknown[0]!r}; it has {', '.join(parameters)}")
        values = {key: value if isinstance(value, list) else [value] for key, value in arguments.items()}
        try:
            TOOL_CALL.check(size=len(compact(arguments).encode()), items=sum(map(len, values.values())))
        except (BudgetError, UnicodeError) as error:
            raise ConfigError(f"{name}: {error}") from error
        if "out" in parameters:
            values["out"] = [self._folder(item) for item in values.get("out", ["." if name == "run" else name])]
        for seeds in values.get("seeds", []):
            with contextlib.suppress(click.BadParameter):  # the command says what is wrong
                if len(seed_range(None, None, str(seeds)) or ()) > _MOST_SEEDS:
                    raise ConfigError(
                        f"{name}: {seeds} are more than {_MOST_SEEDS} seeds, the most of one call; call it several "
                        f"times, or run hiltest {name} --seeds={seeds} at a terminal"
                    )
        options, places = [], []
        for key, parameter in parameters.items():
            if len(values.get(key, [])) > 1 and not (parameter.multiple or parameter.nargs == -1):
                raise ConfigError(f"{name}: {key} has one value, not {len(values[key])}")
            for item in values.get(key, []):
                if isinstance(parameter, click.Argument):
                    places.append(str(item))
                elif item is True:
                    options.append(f"--{key}")
                elif item is not False and item is not None:
                    options.append(f"--{key}={item}")
        return [name, "--json", *options, "--", *places]

    def _folder(self, name: object) -> Path:
        folder = Path(self._out, str(name)).resolve()
        if not folder.is_relative_to(self._out):
            raise ConfigError(f"out: {name} is not below {self._out}, where hiltest mcp writes; name a folder in it")
        return folder

    async def _document(self, words: list[str]) -> dict[str, Any]:
        """Return the document that a command prints; refuse a command that takes too long or prints none."""
        import anyio

        from hiltest.budgets import RECORD
        from hiltest.short_documents import compact

        plugins = f"{os.environ.get('PYTEST_ADDOPTS', '')} --benchmark-storage={self._out.as_uri()}/.benchmarks"
        environment = os.environ | {"PYTEST_ADDOPTS": plugins, "PYTHONDONTWRITEBYTECODE": "1"}
        # -P as the installed command has it: the client's folder is no place to import modules from.
        command = [sys.executable, "-P", "-m", "hiltest", *words]
        try:
            process = await anyio.open_process(
                command, stdin=subprocess.DEVNULL, env=environment, start_new_session=True
            )
        except (OSError, ValueError) as error:
            raise ConfigError(f"{words[0]}: cannot be started: {error}") from error
        self._running.add(process)
        output, errors = bytearray(), bytearray()
        try:
            with anyio.move_on_after(self._timeout_s) as limit:
                async with anyio.create_task_group() as group:
                    group.start_soon(_read_end, process.stdout, output, RECORD.bytes)
                    group.start_soon(_read_end, process.stderr, errors, _LAST_ERRORS)
        finally:
            await _stop(process)
            self._running.discard(process)
        if limit.cancelled_caught:
            raise ConfigError(f"{words[0]}: stopped after {self._timeout_s} s; hiltest mcp --timeout S allows more")
        with contextlib.suppress(ValueError):
            # A lone surrogate, of a name that is no text, cannot be sent.
            document = json.loads(compact(json.loads(output)).encode("utf-8", "replace"))
            if isinstance(document, dict) and "schema" in document:
                return document
        last = errors.decode("utf-8", "replace").strip().rpartition("\n")[2]
        raise ConfigError(f"{words[0]}: printed no document: {last or 'no error either'}")


def _schema(parameter: click.Parameter) -> dict[str, Any]:
    """Return the JSON Schema of a parameter: a text that the command parses, a choice, or a switch."""
    schema: dict[str, Any] = {"type": "string"}
    if isinstance(parameter.type, click.Choice):
        schema["enum"] = list(parameter.type.choices)
    if isinstance(parameter, click.Option) and parameter.is_flag:
        schema = {"type": "boolean"}
    if parameter.multiple or parameter.nargs == -1:
        schema = {"type": "array", "items": schema}
    return schema | {"description": getattr(parameter, "help", None) or parameter.human_readable_name}


async def _read_end(stream: ByteReceiveStream, text: bytearray, most: int) -> None:
    async for piece in stream:
        text += piece
        del text[:-most]


async def _stop(process: Process) -> None:
    """End a process and all that it started: by Ctrl-C, so that a run keeps its record, then at once."""
    import anyio

    with anyio.CancelScope(shield=True):
        with contextlib.suppress(ProcessLookupError):
            if process.returncode is None:
                os.killpg(process.pid, signal.SIGINT)
                with anyio.move_on_after(_GRACE_S):
                    await process.wait()
            os.killpg(process.pid, signal.SIGKILL)
        await process.aclose()
