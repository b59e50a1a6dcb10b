"""The client of the GDB remote protocol: at our own server, at QEMU's, and at servers that are none."""

from __future__ import annotations

import random
import socket
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hiltest.boards.gdb_server import GdbServer
from hiltest.errors import ConfigError, DebugServerError
from hiltest.interfaces.function_return import halt_at_return
from hiltest.interfaces.gdb_client import GdbClient, MemoryRefusedError
from hiltest.interfaces.gdb_wire import TcpWire
from hiltest.link.gdb_packets import LONGEST, PacketReader, packet
from hiltest.virtual.board.k64f import VirtualK64F
from hiltest.virtual.program.elf import FirmwareImage, load_image

from .compiled import InitialMemory, compile_c

SOURCE = (Path(__file__).parent / "programs" / "moving.c").read_text()
WALL_LIMIT_S = 30.0  # for what takes milliseconds


@pytest.fixture(scope="module")
def elf(tmp_path_factory: pytest.TempPathFactory, require_tool: Callable[[str], str]) -> Path:
    return compile_c(require_tool("arm-none-eabi-gcc"), tmp_path_factory.mktemp("moving"), SOURCE)


@contextmanager
def own_server(elf: Path) -> Iterator[int]:
    """Serve the program on a virtual board that runs in a thread; the port."""
    machine, ended = VirtualK64F(elf), threading.Event()

    def run() -> None:
        while not ended.is_set():
            machine.run_until(machine.time_s + 0.002)

    with GdbServer(machine, 0) as server:
        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield server.port
        finally:
            ended.set()
            server.close()
            thread.join(WALL_LIMIT_S)
            assert not thread.is_alive()


@contextmanager
def qemu_server(elf: Path, qemu: str) -> Iterator[int]:
    """Have QEMU emulate the program on another Cortex-M4, and serve it; the port."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [
        qemu,
        "-M",
        "mps2-an386",
        "-nographic",
        "-monitor",
        "none",
        "-serial",
        "none",
        "-kernel",
        str(elf),
        "-S",
        "-gdb",
        f"tcp:127.0.0.1:{port}",
    ]
    process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        yield port
    finally:
        process.kill()
        process.communicate()


def connected(port: int) -> GdbClient:
    """Connect, as soon as something listens."""
    deadline_s = time.monotonic() + WALL_LIMIT_S
    while True:
        try:
            return GdbClient(TcpWire("127.0.0.1", port))
        except DebugServerError:
            assert time.monotonic() < deadline_s
            time.sleep(0.05)


@pytest.fixture(params=["own", pytest.param("qemu", marks=pytest.mark.slow)])
def served(request: pytest.FixtureRequest, elf: Path, require_tool: Callable[[str], str]) -> Iterator[int]:
    """The port of our own server, and of QEMU's."""
    server = own_server(elf) if request.param == "own" else qemu_server(elf, require_tool("qemu-system-arm"))
    with server as port:
        yield port


@pytest.fixture
def client(served: int) -> Iterator[GdbClient]:
    """A client at each of them."""
    with connected(served) as result:
        yield result


@pytest.fixture(scope="module")
def image(elf: Path) -> FirmwareImage:
    return load_image(elf)


def word(client: GdbClient, image: FirmwareImage, name: str) -> int:
    return int.from_bytes(client.read(image.symbols[name].address, 4), "little")


def test_memory_is_read_and_written_in_pieces_of_any_size(client: GdbClient, image: FirmwareImage) -> None:
    code, size = image.symbols["start"].address, 120
    assert client.read(code, size) == InitialMemory(image)(code, size)
    target = 0x20010000
    data = random.Random(1).randbytes(5000) + b"\0" * 3000 + b"#$}*" * 4
    client.write(target, data)
    assert client.read(target, len(data)) == data
    assert client.read(target, 0) == b""
    with pytest.raises(MemoryRefusedError, match="refuses to read 4 bytes at 0xf0000000; check that this ELF runs"):
        client.read(0xF0000000, 4)
    assert client.read(target, 3) == data[:3]


def test_the_processor_runs_between_halts_and_only_then(client: GdbClient, image: FirmwareImage) -> None:
    first = word(client, image, "rounds")
    assert word(client, image, "rounds") == first
    deadline_s = time.monotonic() + WALL_LIMIT_S
    while word(client, image, "rounds") == first:
        assert time.monotonic() < deadline_s
        client.run_for(0.05)
        assert not client.running
    client.go_on()
    assert client.running
    assert client.wait_for_halt(0.05) is None
    assert client.running
    client.halt()
    client.halt()  # it is halted already


def test_a_processor_that_is_left_runs_on(served: int, image: FirmwareImage) -> None:
    with connected(served) as client:
        first = word(client, image, "rounds")
    deadline_s, later = time.monotonic() + 0.2 * WALL_LIMIT_S, first
    while later == first:
        assert time.monotonic() < deadline_s
        time.sleep(0.05)
        with connected(served) as client:
            later = word(client, image, "rounds")


def test_a_function_is_left_when_it_has_returned(client: GdbClient, image: FirmwareImage) -> None:
    entry, calibration = image.symbols["update_calibration"].address, image.symbols["calibration"].address
    halts = []
    for _ in range(4):
        assert halt_at_return(client, entry, 10.0)
        assert image.function_at(client.registers().pc) == image.symbols["main"]
        halts.append(client.read(calibration, 16))
    solutions = [int.from_bytes(halt[12:], "little") for halt in halts]
    assert solutions == list(range(solutions[0], solutions[0] + 4))
    assert len({halt[:4] for halt in halts}) == 4


def test_a_function_that_calls_itself_is_left_where_the_first_call_returns(
    client: GdbClient, image: FirmwareImage
) -> None:
    entry = image.symbols["depth"].address
    assert halt_at_return(client, image.symbols["update_calibration"].address, 10.0)  # the next is the outermost call
    client.set_breakpoint(entry)
    client.go_on()
    assert client.wait_for_halt(10.0) is not None
    client.clear_breakpoint(entry)
    outside = word(client, image, "rounds")
    # The next call is the second of four; the third and the fourth return to the same address before it does.
    assert halt_at_return(client, entry, 10.0)
    assert word(client, image, "rounds") == outside + 3
    assert halt_at_return(client, image.symbols["depth"].address, 10.0)
    before = word(client, image, "rounds")
    for more in (4, 8):
        assert halt_at_return(client, entry, 10.0)
        assert word(client, image, "rounds") == before + more


def test_a_function_that_is_not_called_leaves_the_processor_halted(client: GdbClient, image: FirmwareImage) -> None:
    assert not halt_at_return(client, image.symbols["never_called"].address, 0.05)
    assert not client.running
    assert halt_at_return(client, image.symbols["depth"].address, 10.0)  # its breakpoint is gone


HANDLER = """
#include <stdint.h>
volatile uint32_t ticks;
void SysTick_Handler(void) { ticks++; }
int main(void)
{
    ((volatile uint32_t *)0xE000E010)[1] = 9999;
    ((volatile uint32_t *)0xE000E010)[0] = 7;
    for (;;)
        __asm volatile("wfi");
}
"""


def test_an_exception_handler_returns_to_no_address(tmp_path: Path, require_tool: Callable[[str], str]) -> None:
    elf = compile_c(require_tool("arm-none-eabi-gcc"), tmp_path, HANDLER)
    with own_server(elf) as port, connected(port) as client:
        with pytest.raises(ConfigError, match="is an exception handler without a return address"):
            halt_at_return(client, load_image(elf).symbols["SysTick_Handler"].address, 10.0)
        assert not client.running


# -- servers that are none ---------------------------------------------------------------------


class Hostile:
    """A server that answers what a test wants: a function of what came returns what to send, or None to hang up."""

    def __init__(self, answer: Callable[[bytes], bytes | None]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._answer = answer
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with suppress(OSError):
            peer, _ = self._listener.accept()
            with peer:
                while (data := peer.recv(4096)) and (said := self._answer(data)) is not None:
                    peer.sendall(said)

    def __enter__(self) -> Hostile:
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()
        self._thread.join(WALL_LIMIT_S)


def outcome(answer: Callable[[bytes], bytes | None], *, answer_s: float = 0.2) -> str:
    """Connect to a hostile server and try all that the client does; return what it says then."""
    began_s = time.monotonic()
    try:
        with Hostile(answer) as server, GdbClient(TcpWire("127.0.0.1", server.port), answer_s=answer_s) as client:
            for _ in range(3):
                client.read(0x20000000, 3000)
                client.registers()
                client.set_breakpoint(0x400)
                client.clear_breakpoint(0x400)
                client.run_for(0.05)
        return "took it"
    except DebugServerError as error:
        return str(error)
    finally:
        assert time.monotonic() - began_s < WALL_LIMIT_S


def answering(**by_letter: bytes) -> Callable[[bytes], bytes | None]:
    """Answer each command by its first letter; what is not named as a server would that knows nothing of it."""
    usual = {"q": b"PacketSize=1000", "?": b"S05", "m": b"00", "g": b"00" * 64, "Z": b"OK", "z": b"OK", "c": b"S05"}
    replies = usual | by_letter

    def answer(data: bytes) -> bytes:
        said = b""
        for command in PacketReader().feed(data):
            if isinstance(command, bytes) and command not in (b"\x03", b"-"):
                said += b"+" + packet(replies.get(command[:1].decode("latin-1"), b""))
        return said

    return answer


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (answering(), "took it"),
        (answering(m=b"E01"), "refuses to read 1024 bytes at 0x20000000"),
        (answering(m=b"E.no such memory"), "refuses to read"),
        (answering(m=b""), "answers 'm20000000,400' with ''; is it a GDB server"),
        (answering(m=b"0g"), "with '0g'"),
        (answering(m=b"0"), "with '0'"),
        (answering(m=b"00" * 2000), "answers 'm20000000,400' with '0000"),
        (answering(g=b"E03"), "refuses 'g' ('E03')"),
        (answering(g=b"00" * 20), "answers 'g' with"),
        (answering(g=b"xx" * 64), "does not know the registers SP, LR and PC"),
        (answering(Z=b"E09"), "sets no breakpoint at 0x00000400 ('E09'); free a breakpoint"),
        (answering(Z=b""), "sets no breakpoint"),
        (answering(c=b"W00"), "answers '?' with 'W00'"),
        (answering(c=b"O" + b"hard fault".hex().encode()), "does not halt the processor within 0.2 s"),
        (answering(**{"?": b"W00"}), "answers '?' with 'W00'"),
        (answering(**{"?": b"vCont;c"}), "answers '?' with 'vCont;c'"),
        (lambda _: None, "is gone: it has closed the connection. Check its output, start it again"),
        (
            lambda _: b"",
            "does not answer 'qSupported:swbreak+;hwbreak+' within 0.2 s; check that its probe is connected",
        ),
        (lambda _: b"SSH-2.0-OpenSSH_9.2\r\n", "does not answer"),
        (lambda _: b"$" * 100_000, "does not answer|sends damaged packets"),
        (lambda _: b"$OK#00" * 9, "sends damaged packets; check that it is a GDB server"),
        (lambda _: b"-" * 99, "does not answer"),
        (lambda _: packet(b"T05") * 99, "does not answer"),
        (lambda _: packet(b"O" + b"41" * 900), "does not answer"),
    ],
)
def test_a_server_that_talks_nonsense_is_named_with_the_next_step(
    answer: Callable[[bytes], bytes | None], says: str
) -> None:
    # One that closes the connection does so at once, and on a busy machine later.
    said = outcome(answer, answer_s=10 if "is gone" in says else 0.2)
    assert any(part in said for part in says.split("|")), said


def test_a_server_that_says_no_end_of_words_is_left_in_time() -> None:
    def trickle(peer: socket.socket) -> None:
        with suppress(OSError):
            while True:
                peer.sendall(b"$4")
                time.sleep(0.01)

    with socket.create_server(("127.0.0.1", 0)) as listener:
        wire = TcpWire("127.0.0.1", listener.getsockname()[1])
        peer, _ = listener.accept()
        with peer:
            threading.Thread(target=trickle, args=(peer,), daemon=True).start()
            began_s = time.monotonic()
            with pytest.raises(DebugServerError, match="does not answer"):
                GdbClient(wire, answer_s=0.2)
            assert time.monotonic() - began_s < WALL_LIMIT_S


def test_a_packet_that_was_damaged_on_its_way_is_asked_for_again() -> None:
    usual, spoilt = answering(m=b"ab" * 1024), set()

    def answer(data: bytes) -> bytes | None:
        if data == b"-":
            return packet(b"ab" * 1024)
        said = usual(data)
        if b"$m" in data and data not in spoilt:
            spoilt.add(data)
            return said and said[:-1] + b"?"
        return said

    with Hostile(answer) as server, GdbClient(TcpWire("127.0.0.1", server.port), answer_s=2.0) as client:
        assert client.read(0x20000000, 1024) == b"\xab" * 1024
    assert spoilt


def test_random_answers_end_in_an_error_or_are_taken() -> None:
    for seed in range(40):
        chosen = random.Random(seed)

        def answer(_data: bytes, chosen: random.Random = chosen) -> bytes | None:
            kind = chosen.randrange(8)
            if kind == 0:
                return chosen.randbytes(chosen.randrange(200))
            if kind == 1:
                return None
            if kind < 4:
                return b"+" + packet(chosen.randbytes(chosen.randrange(40)))
            answers = [b"OK", b"", b"E01", b"S05", b"T05", b"00" * 200, b"0*~", b"PacketSize=zz"]
            return b"+" + packet(chosen.choice(answers))

        outcome(answer)


def test_a_port_where_nothing_listens_is_named() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(DebugServerError, match=rf"127\.0\.0\.1:{port}: cannot be reached \(.*\); start OpenOCD"):
        TcpWire("127.0.0.1", port)


# -- packets ------------------------------------------------------------------------------------


def with_runs(content: bytes) -> bytes:
    """Frame an answer as servers do that shorten it: behind a byte, ``*`` and how often it comes again."""
    answer, at = bytearray(), 0
    while at < len(content):
        length = 1
        while at + length < len(content) and content[at + length] == content[at] and length < 98:
            length += 1
        byte = bytes((0x7D, content[at] ^ 0x20)) if content[at] in b"#$}*" else content[at : at + 1]
        count = length - 1 + 29
        if length > 3 and byte[0] != 0x7D and chr(count) not in "#$+-":
            answer += byte + b"*" + bytes((count,))
            at += length
        else:
            answer += byte
            at += 1
    return b"$%s#%02x" % (answer, sum(answer) & 0xFF)


def test_runs_are_written_out() -> None:
    assert list(PacketReader(runs=True).feed(b'$0* #7a$a*"b#0f$a*#8b')) == [b"0000", b"aaaaaab", b"a"]
    assert list(PacketReader(runs=True).feed(packet(b"}*#$"))) == [b"}*#$"]


@given(st.lists(st.tuples(st.integers(0, 255), st.integers(1, 300))), st.data())
def test_what_a_server_shortens_is_read_whole_however_it_is_cut(
    runs: list[tuple[int, int]], data: st.DataObject
) -> None:
    content = b"".join(bytes((byte,)) * count for byte, count in runs)[: LONGEST // 2]
    answer, reader, read = with_runs(content), PacketReader(runs=True), []
    while answer:
        cut = data.draw(st.integers(1, len(answer)))
        read += reader.feed(answer[:cut])
        answer = answer[cut:]
    assert read == [content]


@given(st.binary(max_size=400), st.binary(min_size=1, max_size=40))
def test_behind_any_bytes_the_next_packet_is_found(noise: bytes, content: bytes) -> None:
    reader = PacketReader(runs=True)
    for item in reader.feed(noise + b"#00"):
        assert item is None or isinstance(item, bytes)
    # What the noise began may swallow one packet, and no more.
    assert content in [*reader.feed(packet(content) * 2)]
