"""The compiled kernels of another processor: a shared library for aarch64, run by the CPU emulator Unicorn.

Functions of the C library are those of this machine. Arrays are copied to the memory of the emulated processor before a
call, and back after it.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import struct
import threading
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np
from elftools.elf.elffile import ELFFile
from unicorn import UC_ARCH_ARM64, UC_HOOK_CODE, UC_MODE_ARM, Uc
from unicorn import arm64_const as registers

if TYPE_CHECKING:
    from pathlib import Path

_CODE, _IMPORTS, _STACK, _HEAP = 0x10_0000, 0x1000_0000, 0x2000_0000, 0x4000_0000  # addresses of the emulated memory
_STACK_BYTES, _HEAP_BYTES, _PAGE = 1 << 20, 1 << 27, 1 << 12
_RETURN = 0xD65F03C0  # the instruction `ret`
_INTEGERS = [getattr(registers, f"UC_ARM64_REG_X{i}") for i in range(8)]
_DOUBLES = [getattr(registers, f"UC_ARM64_REG_D{i}") for i in range(8)]
_MATH = ctypes.CDLL(ctypes.util.find_library("m"))
# Relocations of a shared library (ELF for the Arm 64-bit architecture, section 5.7).
_ABSOLUTE, _GLOBAL, _JUMP, _RELATIVE = 257, 1025, 1026, 1027


class EmulatedLibrary:
    """A library of kernels.

    Args:
        path: The shared library, compiled for aarch64.

    Attributes:
        called: Names of the functions that were called.
    """

    def __init__(self, path: Path) -> None:
        self.called: set[str] = set()
        self._lock = threading.Lock()  # there is one processor
        self._machine = Uc(UC_ARCH_ARM64, UC_MODE_ARM)
        self._imports: dict[int, str] = {}
        for start, size in ((_IMPORTS, _PAGE), (_STACK, _STACK_BYTES), (_HEAP, _HEAP_BYTES)):
            self._machine.mem_map(start, size)
        with path.open("rb") as file:
            self._load(ELFFile(file))
        self._machine.hook_add(UC_HOOK_CODE, self._imported, begin=_IMPORTS, end=_IMPORTS + _PAGE - 1)
        control = self._machine.reg_read(registers.UC_ARM64_REG_CPACR_EL1)
        self._machine.reg_write(registers.UC_ARM64_REG_CPACR_EL1, control | 3 << 20)  # floating-point instructions

    def _load(self, elf: ELFFile) -> None:
        """Write the segments into memory, and bind every symbol."""
        segments = list(elf.iter_segments("PT_LOAD"))
        end = max(segment["p_vaddr"] + segment["p_memsz"] for segment in segments)
        self._machine.mem_map(_CODE, -(-end // _PAGE) * _PAGE)
        for segment in segments:
            self._machine.mem_write(_CODE + segment["p_vaddr"], segment.data())
        dynamic = next(elf.iter_segments("PT_DYNAMIC"))
        symbols = list(dynamic.iter_symbols())
        self.functions = {one.name: _CODE + one["st_value"] for one in symbols if one["st_shndx"] != "SHN_UNDEF"}
        missing = sorted({one.name for one in symbols if one.name and one.name not in self.functions})
        self._imports = {_IMPORTS + 4 * i: name for i, name in enumerate(missing, start=1)}  # 0 is the return address
        places = self.functions | {name: address for address, name in self._imports.items()}
        self._machine.mem_write(_IMPORTS, struct.pack("<I", _RETURN) * (len(missing) + 1))
        for entry in chain.from_iterable(
            table.iter_relocations() for table in dynamic.get_relocation_tables().values()
        ):
            kind, value = entry["r_info_type"], entry["r_addend"]
            assert kind in (_ABSOLUTE, _GLOBAL, _JUMP, _RELATIVE), f"relocation {kind}"
            value += _CODE if kind == _RELATIVE else places.get(symbols[entry["r_info_sym"]].name, 0)
            self._machine.mem_write(_CODE + entry["r_offset"], struct.pack("<Q", value))

    def _imported(self, machine: Uc, address: int, _size: int, _data: object) -> None:
        """Run a function of the C library; the emulated processor returns from it next."""
        if address == _IMPORTS:
            return
        name = self._imports[address]
        to, what, count = (machine.reg_read(register) for register in _INTEGERS[:3])
        if name in ("memcpy", "memmove"):
            machine.mem_write(to, bytes(machine.mem_read(what, count)))
        elif name == "memset":
            machine.mem_write(to, bytes([what & 0xFF]) * count)
        else:
            numbers = [_as_double(machine.reg_read(register)) for register in _DOUBLES[:2]]
            found = _of_the_c_library(name, *numbers, ctypes.c_int32(to & 0xFFFFFFFF).value)
            machine.reg_write(_DOUBLES[0], _as_integer(found))

    def call(
        self,
        symbol: str,
        sizes: tuple[int, ...],
        numbers: tuple[float, ...],
        arrays: tuple[tuple[np.ndarray, int], ...],
    ) -> int:
        """Call a function; the arguments are those of `optdock.kernels.Kernel`."""
        with self._lock:
            return self._call(symbol, sizes, numbers, arrays)

    def _call(self, symbol: str, sizes: tuple, numbers: tuple, arrays: tuple) -> int:
        self.called.add(symbol)
        machine, places, free = self._machine, [], _HEAP
        for array, count in arrays:
            assert array.flags.c_contiguous, symbol
            assert array.size == count, symbol
            machine.mem_write(free, array.tobytes())
            places.append(free)
            free += 16 * (array.nbytes // 16 + 2)
        assert free <= _HEAP + _HEAP_BYTES, symbol
        # The first eight arguments of each kind are in registers, the others on the stack in their order (AAPCS64).
        integers, doubles, stacked = iter(_INTEGERS), iter(_DOUBLES), []
        given = [(value % 2**64, integers) for value in sizes]
        given += [(_as_integer(value), doubles) for value in numbers]
        for value, free_registers in [*given, *((place, integers) for place in places)]:
            register = next(free_registers, None)
            if register is None:
                stacked.append(value)
            else:
                machine.reg_write(register, value)
        top = _STACK + _STACK_BYTES - 16 * (len(stacked) // 2 + 1)
        machine.mem_write(top, struct.pack(f"<{len(stacked)}Q", *stacked))
        machine.reg_write(registers.UC_ARM64_REG_SP, top)
        machine.reg_write(registers.UC_ARM64_REG_LR, _IMPORTS)
        machine.emu_start(self.functions[symbol], _IMPORTS)
        for (array, _), place in zip(arrays, places, strict=True):
            if array.flags.writeable:
                array[...] = np.frombuffer(machine.mem_read(place, array.nbytes), array.dtype).reshape(array.shape)
        return ctypes.c_int64(machine.reg_read(_INTEGERS[0])).value


def _of_the_c_library(name: str, one: float, other: float, integer: int) -> float:
    """Return the result of a function of `math.h`."""
    function = getattr(_MATH, name)
    function.restype = ctypes.c_double
    if name == "ldexp":
        return function(ctypes.c_double(one), integer)
    both = name in ("hypot", "atan2", "fmax", "fmin", "pow", "fmod", "copysign")
    return function(*map(ctypes.c_double, (one, other) if both else (one,)))


def _as_integer(number: float) -> int:
    return struct.unpack("<Q", struct.pack("<d", number))[0]


def _as_double(integer: int) -> float:
    return struct.unpack("<d", struct.pack("<Q", integer))[0]
