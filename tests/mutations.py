"""Damage for files: seeded changes to bytes, to numbers, and to what containers hold.

Blind changes rarely get past a checksum. Hence members of zip archives, chunks of PNG and
compressed elements of MATLAB files are changed within, and the container is closed again.
"""

from __future__ import annotations

import io
import pickle
import pickletools
import re
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import PurePath

import numpy as np

# What a header could claim: sizes about the limits of every kind of integer, and plain large ones.
INTEGERS = (
    *(0, 1, 2, 3, 127, 128, 255, 256, 2**15, 2**16 - 1, 10**6, 2**24, 10**8, 2**30),
    *(2**31 - 1, 2**31, 2**32 - 2, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**63, 2**64 - 1),
)
WORDS = (
    *(b"nan", b"-inf", b"inf", b"1e308", b"-1e308", b"1e39", b"1e400", b"1e-320", b"-0", b"0"),
    *(b"-1", b"0.5", b"4000000000", b"99999999999999999999", b"9" * 5000, b"x", b"", b"1_0"),
    *(b"0x10", b"\xff\xfe", b"\xd9\xa3", b"1 2 3", b"-9223372036854775808", b"1e9"),
)
MAGICS = (
    *(b"", b"PK\x03\x04", b"\x93NUMPY\x01\x00", b"\x89HDF\r\n\x1a\n", b"MATLAB 5.0 MAT-file"),
    *(b"\x80\x04", b"ply\n", b"#VRML V2.0 utf8\n", b"BM", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"),
    *(b"GIF89a", b"II*\x00", b"%!PS-Adobe-3.0 EPSF-3.0\n", b"\x1f\x8b\x08", b"\xef\xbb\xbf"),
    *(b"\xff\xfe", b"{", b"[" * 5000, b'{"a":' * 5000, b"((((" * 500),
)
SHAPES = (
    *("(1000000000, 1000000000)", "(4000000000,)", "(100000000, 3)", "(3, 300000000)", "(-1, 3)"),
    *("()", "(0,)", "(0, 3)", "(1,)", "(9223372036854775807,)", "(2L, 3L)", "(3, 2.0)", "[3]"),
    *("(True, 3)", "((3,), 2)", "(" * 300 + ")" * 300, "3", "None", "(4, 1000000000, 0)"),
)
KINDS = (
    *("'|O'", "'<U100000000'", "'|S100000000'", "'|V8'", "'<c16'", "'>f8'", "'|b1'", "'<M8[s]'"),
    *("'<U4'", "'|S4'", "'<f2'", "'<f16'", "'<i8'", "'|u1'", "[('a', '<f8')]", "'\\d'", "'x'"),
    *("None", "('<f8', (100000000,))", "[('a', '<f8', (3,))]", "'<u8'", "'<m8'", "'|U0'", "1is"),
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?")
_HEADER = 300  # bytes, where half of the changes are made


def damaged(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    """A file with one to three changes, of kinds that suit the suffix of its name."""
    change = _BY_SUFFIX.get(PurePath(name).suffix.lower(), change_bytes)
    for _ in range(1 + rng.choice(3, p=(0.7, 0.2, 0.1))):
        try:
            data = change(data, rng)
        except Exception:  # an earlier change left nothing that can be taken apart
            data = change_bytes(data, rng)
    return data


def change_bytes(data: bytes, rng: np.random.Generator, places: np.ndarray | None = None) -> bytes:
    """One change to any file.

    Args:
        data: The file.
        rng: Decides.
        places: Where structure is rather than mere numbers, for half of the changes; by default
            the first few hundred bytes.
    """
    if not data:
        return rng.bytes(8)
    if rng.random() < 0.5:
        start = int(rng.integers(len(data)))
    else:
        start = int(rng.choice(places) if places is not None else rng.integers(_HEADER))
    start %= len(data)
    length = int(min(2 ** rng.uniform(0, 8), len(data) - start))
    stop = start + length
    before, run, after = data[:start], data[start:stop], data[stop:]
    match rng.choice(12):
        case 0:  # a bit
            return before + bytes([data[start] ^ 1 << rng.integers(8)]) + data[start + 1 :]
        case 1:  # a byte
            return before + rng.bytes(1) + data[start + 1 :]
        case 2:
            return before + rng.bytes(length) + after
        case 3:
            return before + after
        case 4:
            return before + rng.bytes(length) + run + after
        case 5:
            return before + run * int(rng.choice([2, 3, 100])) + after
        case 6:  # copied over another place
            other = int(rng.integers(len(data)))
            return data[:other] + run + data[other + length :]
        case 7:
            return before
        case 8 | 9:
            return _with_integer(data, start, rng)
        case 10:
            return _with_word(data, start, rng)
        case _:
            return _grown(data, start, rng)


def change_npy(data: bytes, rng: np.random.Generator) -> bytes:
    """One change to an array in NumPy's format; two in three are lies in its header."""
    if rng.random() < 1 / 3 or data[:6] != b"\x93NUMPY":
        return change_bytes(data, rng)
    (length,) = struct.unpack_from("<H", data, 8)
    header, body = data[10 : 10 + length].decode("latin1"), data[10 + length :]
    if rng.random() < 0.5:
        header = re.sub(r"'shape': .*?\), ?", lambda _: f"'shape': {rng.choice(SHAPES)}, ", header)
    else:
        header = re.sub(r"'descr': .*?, '", lambda _: f"'descr': {rng.choice(KINDS)}, '", header)
    if rng.random() < 0.1:
        header = header.replace("False", "True")
    return data[:8] + struct.pack("<H", len(header)) + header.encode("latin1") + body


def change_npz(data: bytes, rng: np.random.Generator) -> bytes:
    """One change to a zip archive, or to a member of it, which gets the right checksum."""
    if rng.random() < 0.3:
        return change_bytes(data, rng, _central_directory(data))
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = str(rng.choice([*members]))
    match rng.choice(10):
        case 0:
            del members[name]
        case 1:
            members[name] = members[str(rng.choice([*members]))]
        case _:
            members[name] = change_npy(members[name], rng)
    written = io.BytesIO()
    with zipfile.ZipFile(written, "w", rng.choice([zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])) as z:
        for name, member in members.items():
            z.writestr(zipfile.ZipInfo(name), member, z.compression)
    return written.getvalue()


def change_mat(data: bytes, rng: np.random.Generator) -> bytes:
    """One change to a MATLAB 5 file, or to an array of it, compressed or not."""
    if rng.random() < 0.3:
        return change_bytes(data, rng)
    elements, start = [], 128
    while start < len(data):
        kind, length = struct.unpack_from("<II", data, start)
        element = data[start : start + 8 + length]
        elements.append(zlib.decompress(element[8:]) if kind == 15 else element)
        start += 8 + length
    chosen = int(rng.integers(len(elements)))
    elements[chosen] = change_bytes(elements[chosen], rng, np.arange(8, 64))
    if rng.random() < 0.5:
        pressed = map(zlib.compress, elements)
        elements = [struct.pack("<II", 15, len(element)) + element for element in pressed]
    return data[:128] + b"".join(elements)


def change_png(data: bytes, rng: np.random.Generator) -> bytes:
    """One change to a PNG, or to a chunk of it, which gets the right checksum."""
    if rng.random() < 0.3:
        return change_bytes(data, rng)
    chunks, start = [], 8
    while start < len(data):
        (length,) = struct.unpack_from(">I", data, start)
        chunks.append(data[start + 4 : start + 8 + length])
        start += 12 + length
    chosen = int(rng.integers(len(chunks)))
    kind, body = chunks[chosen][:4], chunks[chosen][4:]
    if kind == b"IDAT" and rng.random() < 0.5:
        chunks[chosen] = kind + zlib.compress(change_bytes(zlib.decompress(body), rng))
    elif kind == b"IHDR" and rng.random() < 0.5:
        sides = rng.choice([0, 1, 40, 9000, 60_000, 2**31 - 1], 2).tolist()
        chunks[chosen] = kind + struct.pack(">II", *sides) + body[8:]
    else:
        chunks[chosen] = kind + change_bytes(body or b"\0", rng)
    return data[:8] + b"".join(
        struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
        for chunk in chunks
    )


def change_pickle(data: bytes, rng: np.random.Generator) -> bytes:
    """One change to a pickle, mostly about its opcodes; or another program in its place."""
    if rng.random() < 0.2:
        return pickle_program(rng)
    places = [position for _, _, position in pickletools.genops(data)]
    start = int(rng.choice(places))
    match rng.choice(4):
        case 0:  # another opcode
            opcode = str(rng.choice([*pickletools.code2op])).encode("latin1")
            return data[:start] + opcode + data[start + 1 :]
        case 1:  # a length or number
            return _with_integer(data, start + 1, rng)
        case _:
            return change_bytes(data, rng, np.array(places))


def change_hdf5(data: bytes, rng: np.random.Generator) -> bytes:
    """One change to an HDF5 file, mostly where it is not padding."""
    return change_bytes(data, rng, np.flatnonzero(np.frombuffer(data, np.uint8)))


_ALLOWED = (
    *("numpy dtype", "numpy ndarray", "numpy.core.multiarray _reconstruct", "_codecs encode"),
    *("numpy._core.multiarray scalar", "numpy.core.numeric _frombuffer", "chumpy.ch Ch"),
    *("scipy.sparse._csc csc_matrix", "scipy.sparse.csr csr_matrix", "scipy.sparse coo_array"),
    *("copy_reg _reconstructor", "copyreg _reconstructor", "__builtin__ object", "builtins set"),
    *("builtins bytes", "builtins complex", "builtins frozenset", "collections OrderedDict"),
)
_HOSTILE = (
    *("posix system", "os mkdir", "builtins eval", "__builtin__ getattr", "builtins bytearray"),
    *("copyreg __newobj__", "copyreg add_extension", "functools partial", "operator attrgetter"),
    *("numpy fromfile", "numpy.core.multiarray dot", "data_gen.formats.plain_pickle _Unpickler"),
    *(
        "builtins __import__",
        "subprocess Popen",
        "pickle loads",
        "numpy load",
        "types FunctionType",
    ),
    *("chumpy.ch system", "scipy.sparse csr_matrix.__class__", "collections abc.sys"),
)
_VALUES = (
    *(b"N", b"\x88", b"K\x00", b"K\x03", b"J\xff\xff\xff\xff", b"J\xff\xff\xff\x7f", b")", b"]"),
    *(b"}", b"\x8f", b"G" + struct.pack(">d", 1.5), b"\x8a\x09" + b"\xff" * 8 + b"\0"),
    *(pickle.dumps(value, 2)[2:-1] for value in ("f8", "O8", "U999999999", "latin1", "rot13")),
    *(pickle.dumps(value, 2)[2:-1] for value in ("_shape", "indptr", "x", "__class__", "<", "|")),
    *(pickle.dumps(value, 3)[2:-1] for value in (b"", bytes(8), bytes(24), "touch HARM")),
    *(pickle.dumps(value, 2)[2:-1] for value in ((3,), (1, 3), (0,), (10**9, 10**9), (-1,))),
)


def pickle_program(rng: np.random.Generator) -> bytes:
    """A pickle that calls and builds at random what may be called, and what may not."""
    return b"\x80\x04" + _pickled(rng, 4) + b"."


def _pickled(rng: np.random.Generator, depth: int) -> bytes:
    """Opcodes that leave one thing on the stack."""
    if depth == 0 or rng.random() < 0.2:
        return _VALUES[rng.integers(len(_VALUES))]
    name = str(rng.choice(_ALLOWED if rng.random() < 0.9 else _HOSTILE)).encode()
    named = b"c" + name.replace(b" ", b"\n") + b"\n"
    some = b"".join(_pickled(rng, depth - 1) for _ in range(rng.integers(5)))
    one, other = _pickled(rng, depth - 1), _pickled(rng, depth - 1)
    match rng.choice(11):
        case 0:
            return named
        case 1 | 2:
            return named + b"(" + some + b"tR"
        case 3:
            return named + b"(" + some + b"t\x81"
        case 4:
            return b"(" + some + b"i" + named[1:]
        case 5 | 6:
            return named + b"(" + some + b"tR" + one + b"b"
        case 7:
            return one + other + b"b"
        case 8:
            return b"}" + one + other + b"s"
        case 9:
            return b"(" + some + b"t\x94" + one + b"h\x00\x86"
        case _:
            return one + b"(" + some + b"tR"


def _with_integer(data: bytes, start: int, rng: np.random.Generator) -> bytes:
    """Four bytes, or 1, 2 or 8, overwritten by a number that is not the right one."""
    size = int(rng.choice([1, 2, 4, 4, 4, 8]))
    number = int(rng.choice(np.array(INTEGERS, np.uint64))) % 256**size
    return (
        data[:start] + number.to_bytes(size, rng.choice(["little", "big"])) + data[start + size :]
    )


def _with_word(data: bytes, start: int, rng: np.random.Generator) -> bytes:
    """The next number that is written as text becomes another word."""
    match = _NUMBER.search(data, start) or _NUMBER.search(data)
    if match is None:
        return data[:start]
    return data[: match.start()] + WORDS[rng.integers(len(WORDS))] + data[match.end() :]


def _grown(data: bytes, start: int, rng: np.random.Generator) -> bytes:
    """Another beginning, a second copy, an endless word, or noise behind."""
    match rng.choice(4):
        case 0:
            return MAGICS[rng.integers(len(MAGICS))] + data[int(rng.choice([0, 8])) :]
        case 1:
            return data + data
        case 2:
            return data[:start] + data[start : start + 1] * 20_000 + data[start:]
        case _:
            return data + rng.bytes(50)


def _central_directory(data: bytes) -> np.ndarray | None:
    start = data.find(b"PK\x01\x02")
    return np.arange(start, len(data)) if start >= 0 else None


_BY_SUFFIX: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    **{".npy": change_npy, ".npz": change_npz, ".mat": change_mat, ".png": change_png},
    **{".pkl": change_pickle, ".h5": change_hdf5},
}
