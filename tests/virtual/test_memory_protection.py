"""The SYSMPU refuses loads and stores in regions without rights, and says which in its registers."""

from __future__ import annotations

import pytest

from hiltest.errors import BoardFault
from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, word

# The core's rights in user and supervisor mode are the lowest five bits.
NO_WRITE, NO_ACCESS = 0x61F7C0 | 0b01_101, 0x61F7C0 | 0b11_000
# As NXP's example: region 0 loses the core's right to write, region 1 gives it back except in an array, and the handler
# of the bus fault restores the right, so that the store is carried out when it is repeated.
PROGRAM = """
#define CESR WORD(0x4000D000)
#define RGDAAC0 WORD(0x4000D800)
__attribute__((aligned(32))) volatile unsigned guarded[8];
volatile unsigned faults, status, address, detail, cleared, bfar, after, before = 5;
void BusFault_Handler(void) {
  faults++;
  bfar = WORD(0xE000ED38);
  status = CESR;
  unsigned port = 3;
  address = WORD(0x4000D010 + 8 * port);
  detail = WORD(0x4000D014 + 8 * port);
  RGDAAC0 = 0x61F7DF;
  CESR |= 0;
  cleared = CESR;
}
static void region(unsigned number, unsigned begin, unsigned end, unsigned rights) {
  WORD(0x4000D400 + 16 * number) = begin;
  WORD(0x4000D404 + 16 * number) = end;
  WORD(0x4000D408 + 16 * number) = rights;
  WORD(0x4000D40C + 16 * number) = 1;
}
int main(void) {
  WORD(0xE000ED24) |= 1u << 17;
  region(1, 0x1FFF0000, (unsigned)guarded - 1, 0x61F7DF);
  region(2, (unsigned)guarded + 32, 0x2002FFFF, 0x61F7DF);
  region(3, 0, 0xFFFFF, 0x61F7DF);
  %s
  return 0;
}
"""


def board_with(build_c: Build, body: str) -> VirtualK64F:
    board = VirtualK64F(build_c(PROGRAM % body))
    board.run_until(0.002)
    return board


def test_a_refused_store_is_a_bus_fault_with_its_address_and_is_done_when_the_right_is_back(build_c: Build) -> None:
    board = board_with(build_c, f"RGDAAC0 = 0x{NO_WRITE:x}; after = guarded[3]; guarded[3] = 7; after = guarded[3];")
    place = board.image.symbols["guarded"].address + 12
    assert (word(board, "faults"), word(board, "after")) == (1, 7)
    assert (word(board, "address"), word(board, "bfar")) == (place, place)
    assert word(board, "status") == 0x10815101, "SPERR of slave port 3, SRAM_U"
    assert word(board, "cleared") == 0x00815101, "a one clears it"
    assert word(board, "detail") == 1 << 31 | 3 << 1 | 1, "region 0, master 0, supervisor data, a write"
    (record,) = board.faults
    assert f"write refused by the SYSMPU at address 0x{place:08x} (4 bytes)" in str(record.fault)


def test_a_load_is_refused_without_the_right_to_read(build_c: Build) -> None:
    board = board_with(build_c, f"guarded[1] = 9; RGDAAC0 = 0x{NO_ACCESS:x}; after = guarded[1];")
    assert (word(board, "faults"), word(board, "after")) == (1, 9)
    assert word(board, "detail") == 1 << 31 | 3 << 1
    assert "read refused by the SYSMPU" in str(board.faults[0].fault)


def test_no_region_is_another_detail_than_a_region_without_the_right(build_c: Build) -> None:
    body = (
        "RGDAAC0 = 0x61F7C0 | 13; region(4, (unsigned)guarded, (unsigned)guarded + 31, 0x61F7C0 | 13); guarded[0] = 1;"
    )
    assert word(board_with(build_c, body), "detail") >> 16 == 1 << 15 | 1 << 11, "regions 0 and 4"


@pytest.mark.parametrize(
    "body", ["CESR &= ~1u;", "RGDAAC0 = 0x61F7DF;", "region(4, (unsigned)guarded, (unsigned)guarded + 31, 0x61F7DF);"]
)
def test_any_region_with_the_right_permits_and_without_vld_all_do(build_c: Build, body: str) -> None:
    board = board_with(build_c, f"RGDAAC0 = 0x{NO_WRITE:x}; {body} guarded[3] = 7; after = guarded[3];")
    assert (word(board, "faults"), word(board, "after")) == (0, 7)


def test_descriptors_are_as_on_the_part(build_c: Build) -> None:
    body = "WORD(0x4000D400) = 0x20000000; WORD(0x4000D408) = 0; after = WORD(0x4000D408); status = WORD(0x4000D400);"
    body += "WORD(0x4000D454) = 0x2000000; detail = WORD(0x4000D454); address = WORD(0x4000D45C);"
    body += "cleared = WORD(0x4000D814);"
    board = board_with(build_c, f"CESR &= ~1u; region(5, 64, 127, 0x61F7DF); {body}")
    assert word(board, "status") == 0, "region 0 keeps its addresses"
    assert word(board, "after") == 0x7C0, "and the debugger its rights"
    assert word(board, "detail") == 0x200001F
    assert word(board, "address") == 0, "a new address makes a descriptor invalid"
    assert word(board, "cleared") == 0x61F7DF


def test_a_snapshot_keeps_the_protection(build_c: Build) -> None:
    board = board_with(build_c, f"RGDAAC0 = 0x{NO_WRITE:x}; for (;;) if (before != 5) guarded[0] = before;")
    snapshot = board.snapshot()
    for _ in range(2):
        board.processor.memory.write_words(board.image.symbols["before"].address, [6])
        board.run_until(board.time_s + 0.001)
        assert (word(board, "faults"), word(board, "guarded")) == (1, 6)
        board.restore(snapshot)


def test_without_a_handler_the_run_ends_with_the_reason(build_c: Build) -> None:
    body = f"WORD(0xE000ED24) = 0; RGDAAC0 = 0x{NO_WRITE:x}; guarded[3] = 7;"
    with pytest.raises(BoardFault, match="write refused by the SYSMPU at address 0x"):
        board_with(build_c, body)
