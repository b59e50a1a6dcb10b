"""An I2C module as slave of the other one: address, bytes in both directions, acknowledgement, and STOP."""

from __future__ import annotations

from hiltest.virtual.board.k64f import VirtualK64F

from .conftest import Build, word

# As NXP's example for one board: I2C0 is the master, and I2C1, by interrupts, the slave at 0x7E >> 1. The
# handler is the state machine of the reference manual, figure "Typical I2C interrupt routine".
PROGRAM = """
#define M(offset) BYTE(0x40066000 + (offset))
#define T(offset) BYTE(0x40067000 + (offset))
volatile unsigned char heard[8], sent[4] = {0x11, 0x22, 0x33, 0x44}, fetched[8];
volatile unsigned heard_count, sent_count, calls, stops, acknowledged, nacks, master_acks;
void Interrupt25_Handler(void) {
  unsigned char status = T(3);
  if (T(6) & 0x40) {
    T(6) |= 0x40;
    T(3) = 2;
    stops++;
    if (!(status & 0x40)) return;
  }
  T(3) = 2;
  if (status & 0x40) {
    calls++;
    sent_count = 0;
    if (status & 4) {
      T(2) |= 0x10;
      T(4) = sent[sent_count++];
    } else {
      T(2) = (T(2) & ~0x18) | (%(refuse)s ? 8 : 0);
      (void)T(4);
    }
  } else if (T(2) & 0x10) {
    if (status & 1) {
      nacks++;
      T(2) &= ~0x10;
      (void)T(4);
    } else {
      T(4) = sent[sent_count++ %% 4];
    }
  } else {
    heard[heard_count++ %% 8] = T(4);
  }
}
static void finish(void) {
  while (!(M(3) & 2)) { }
  M(3) = 2;
  master_acks += !(M(3) & 1);
}
int main(void) {
  WORD(0x40048034) |= 3u << 6;
  WORD(0xE000E100) = 1u << 25;
  T(0) = 0x7E;
  T(6) = 0x20;
  T(2) = 0xC0;
  M(1) = 0x14;
  M(2) = 0x80;
  M(2) = 0xB0;
  M(4) = %(address)s;
  finish();
  acknowledged = !(M(3) & 1);
  for (int i = 0; i < 3; i++) {
    M(4) = 0xA0 + i;
    finish();
  }
  M(2) |= 4;
  M(4) = %(address)s | 1;
  finish();
  M(2) &= ~0x10;
  (void)M(4);
  for (int i = 0; i < 4; i++) {
    finish();
    if (i == 2) M(2) |= 8;
    if (i == 3) M(2) &= ~0x28;
    fetched[i] = M(4);
  }
  for (;;) { }
}
"""


def run(build_c: Build, *, address: str = "0x7E", refuse: str = "0") -> VirtualK64F:
    board = VirtualK64F(build_c(PROGRAM % {"address": address, "refuse": refuse}))
    board.run_until(0.02)
    return board


def values(board: VirtualK64F, name: str, count: int) -> list[int]:
    address = board.image.symbols[name].address
    return [*board.processor.memory.read(address, count)]


def test_the_slave_hears_the_master_and_the_master_reads_the_slave(build_c: Build) -> None:
    board = run(build_c)
    assert (word(board, "acknowledged"), word(board, "calls")) == (1, 2)
    assert values(board, "heard", 4) == [0xA0, 0xA1, 0xA2, 0]
    assert values(board, "fetched", 4) == [0x11, 0x22, 0x33, 0x44]
    assert (word(board, "nacks"), word(board, "stops")) == (1, 1)
    assert board.faults == ()


def test_the_slave_may_refuse_bytes(build_c: Build) -> None:
    refused, accepted = run(build_c, refuse="1"), run(build_c)
    assert (word(refused, "acknowledged"), values(refused, "heard", 3)) == (1, [0xA0, 0xA1, 0xA2])
    assert word(accepted, "master_acks") - word(refused, "master_acks") == 3


def test_another_address_is_not_the_slaves(build_c: Build) -> None:
    board = run(build_c, address="0x7C")
    assert (word(board, "acknowledged"), word(board, "calls"), word(board, "heard_count")) == (0, 0, 0)


def test_a_snapshot_keeps_the_slaves_state(build_c: Build) -> None:
    board = VirtualK64F(build_c(PROGRAM % {"address": "0x7E", "refuse": "0"}))
    board.run_until(0.0004)
    snapshot = board.snapshot()
    for _ in range(2):
        board.run_until(0.02)
        assert values(board, "fetched", 4) == [0x11, 0x22, 0x33, 0x44]
        board.restore(snapshot)
