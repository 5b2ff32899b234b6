"""What happens to files: bits flip, ends are lost, parts come twice, and people type the wrong thing."""

import gzip
import io
import re
import zipfile
import zlib

import numpy as np

WORDS = [
    b"nan", b"inf", b"-inf", b"1e400", b"-1", b"0", b"1_0.0", b"252.0", "٣".encode(), b"null", b"true", b'""',
    b"[]", b"{}", b"1e200", b"99999999", b"4294967296", b"9223372036854775808", b"-2147483649", b"1e-320",
    b"9" * 5000, b"0x" + b"f" * 5000, b"x" * 140_000, b"[" * 3000, b'{"a":' * 3000, b"\xff\xfe", b"\x00",
    b"\n\n",    b"'", b"!!python/object:os.system", b"---", b"#", b",", b"=", b"1979-05-27T07:32:00Z", b"%s",
]  # fmt: skip
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def flip(data: bytearray, rng: np.random.Generator) -> None:
    """Single bits."""
    for at in rng.integers(0, len(data), rng.integers(1, 5)):
        data[at] ^= 1 << int(rng.integers(8))


def overwrite(data: bytearray, rng: np.random.Generator) -> None:
    """A few bytes of anything."""
    at, n = int(rng.integers(len(data))), int(rng.integers(1, 40))
    data[at : at + n] = rng.bytes(len(data[at : at + n]))


def cut(data: bytearray, rng: np.random.Generator) -> None:
    """The end is lost."""
    del data[int(rng.integers(len(data))) :]


def remove(data: bytearray, rng: np.random.Generator) -> None:
    """A part in the middle is lost."""
    at = int(rng.integers(len(data)))
    del data[at : at + int(rng.integers(1, 200))]


def repeat(data: bytearray, rng: np.random.Generator) -> None:
    """A part comes twice, somewhere."""
    at, n, to = int(rng.integers(len(data))), int(rng.integers(1, 300)), int(rng.integers(len(data)))
    data[to:to] = data[at : at + n]


def insert(data: bytearray, rng: np.random.Generator) -> None:
    """A word that does not belong there."""
    at = int(rng.integers(len(data)))
    data[at:at] = WORDS[rng.integers(len(WORDS))]


def retype(data: bytearray, rng: np.random.Generator) -> None:
    """A number becomes another word."""
    found = list(_NUMBER.finditer(data, 0, 200_000))
    if found:
        place = found[rng.integers(len(found))]
        data[place.start() : place.end()] = WORDS[rng.integers(len(WORDS))]


def swap_lines(data: bytearray, rng: np.random.Generator) -> None:
    """Two lines change places."""
    lines = bytes(data).split(b"\n")
    i, j = rng.integers(0, len(lines), 2)
    lines[i], lines[j] = lines[j], lines[i]
    data[:] = b"\n".join(lines)


KINDS = (flip, overwrite, cut, remove, repeat, insert, retype, retype, swap_lines)


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """The content of a file after one to three of them; of a packed one, often what is packed."""
    inside = rng.random() < 0.7
    if inside and data[:2] == b"\x1f\x8b":
        return gzip.compress(mutated(gzip.decompress(data), rng), compresslevel=1)
    if inside and data[:4] == b"PK\x03\x04":
        return _member_mutated(data, rng)
    made = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        if made:
            KINDS[rng.integers(len(KINDS))](made, rng)
    return bytes(made)


def _member_mutated(data: bytes, rng: np.random.Generator) -> bytes:
    with zipfile.ZipFile(io.BytesIO(data)) as old:
        parts = {name: old.read(name) for name in old.namelist()}
    name = sorted(parts)[rng.integers(len(parts))]
    parts[name] = mutated(parts[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as new:
        for key, content in parts.items():
            new.writestr(key, content)
    return out.getvalue()


def page_mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """Of a database: bits, bytes and whole pages, so that most of it stays one."""
    made = bytearray(data)
    kind = rng.integers(3)
    if kind == 0:
        flip(made, rng)
    elif kind == 1:
        overwrite(made, rng)
    else:
        page = 4096 * int(rng.integers(len(made) // 4096))
        made[page : page + 4096] = bytes(4096) if rng.random() < 0.5 else rng.bytes(4096)
    return bytes(made)


def seed_of(name: str, number: int) -> list[int]:
    """The seed of a mutated file: the same file of another reader is another."""
    return [zlib.crc32(name.encode()), number]
