"""What a pickle asks of whoever reads it, found out without doing any of it."""

from __future__ import annotations

import pickletools
from itertools import count

# How many bytes hold the length of an argument, by pickletools' code for its kind.
_LENGTH_BYTES = {
    pickletools.TAKEN_FROM_ARGUMENT1: 1,
    pickletools.TAKEN_FROM_ARGUMENT4: 4,
    pickletools.TAKEN_FROM_ARGUMENT4U: 4,
    pickletools.TAKEN_FROM_ARGUMENT8U: 8,
}
_PUTS, _GETS = ("PUT", "BINPUT", "LONG_BINPUT"), ("GET", "BINGET", "LONG_BINGET")
_DEEPEST, _MOST_TUPLES = 100, 100_000  # within one tuple, counting each as often as it is met
_OTHER = (0, 0)
_Stack = list[tuple[int, int] | None]


def check_opcodes(data: bytes) -> int:
    """Protocol of a pickle that can be read at a cost that its size is in proportion to.

    No length exceeds the file, and no memo number its count: Python allots memory for either before
    it finds out, gigabytes for a file of a few bytes. And no tuple holds tuples that hold tuples
    without end: Python crashes when it looks for the hash of a deep one, as of a key, and takes
    for ever where each holds another twice.

    Raises:
        ValueError, LookupError, TypeError: It is none.
    """
    protocol = position = 0
    stack: _Stack = []  # of each thing, how deep tuples are in it and how many; None is a mark
    memo: dict[int, tuple[int, int] | None] = {}
    for n_before in count():
        opcode = pickletools.code2op[chr(data[position])]
        protocol = max(protocol, opcode.proto)
        start = position = position + 1
        position = _end_of_argument(opcode, data, start)
        if position > len(data):
            raise ValueError(f"{opcode.name} at {start - 1} needs {position} bytes")
        number = 0
        if opcode.name in _PUTS + _GETS:
            argument = data[start:position]
            number = int(argument) if opcode.proto == 0 else int.from_bytes(argument, "little")
        if opcode.name in _PUTS:
            if number > n_before:
                raise ValueError(f"{opcode.name} at {start - 1} of number {number}")
            memo[number] = stack[-1]
        elif opcode.name == "MEMOIZE":
            memo[len(memo)] = stack[-1]
        elif opcode.name in _GETS:
            stack.append(memo[number])
        elif opcode.name == "DUP":
            stack.append(stack[-1])
        elif opcode.name == "MARK":
            stack.append(None)
        else:
            taken, made = _taken(opcode, stack), _OTHER
            if opcode.name.startswith("TUPLE"):
                depths, numbers = zip(_OTHER, *taken, strict=True)
                made = 1 + max(depths), 1 + sum(numbers)
                if made[0] > _DEEPEST or made[1] > _MOST_TUPLES:
                    raise ValueError(f"{opcode.name} at {start - 1} of {made[1]} tuples in tuples")
            stack += [made] * len(opcode.stack_after)
        if opcode.name == "STOP":
            return protocol


def _end_of_argument(opcode: pickletools.OpcodeInfo, data: bytes, start: int) -> int:
    length = 0 if opcode.arg is None else opcode.arg.n
    if length == pickletools.UP_TO_NEWLINE:
        end = start
        for _ in range(2 if opcode.name in ("GLOBAL", "INST") else 1):
            end = data.index(b"\n", end) + 1
        return end
    if length in _LENGTH_BYTES:
        end = start + _LENGTH_BYTES[length]
        return end + int.from_bytes(data[start:end], "little")
    return start + length


def _taken(opcode: pickletools.OpcodeInfo, stack: _Stack) -> _Stack:
    """What an opcode takes from the stack: so many things, or all down to a mark and some below."""
    before, taken = opcode.stack_before, []
    if pickletools.markobject in before or (opcode.name == "POP" and stack[-1] is None):
        while (top := stack.pop()) is not None:
            taken.append(top)
        n_below = before.index(pickletools.markobject) if len(before) > 1 else 0
    else:
        n_below = len(before)
    return taken + [stack.pop() for _ in range(n_below)]
