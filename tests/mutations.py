"""Ways to break a file: bytes, lines of text, JSON. Each gives another file for another random state."""

import json
import struct
import zlib

NUMBERS = ("nan", "inf", "-inf", "1e308", "1e400", "-1", "0", "-0.0", "1e-320", "9" * 29, "9" * 400, "1_0", "0x10", "٣")
NAMES = (
    "../out.png",
    "/etc/hostname",
    "..",
    ".",
    "a/../../b",
    "rgb",
    "x" * 5000,
    "\0",
    "é\u202e",
    "\\..\\b",
    "CON",
    "",
)
WORDS = (*NUMBERS, *NAMES, "#", ",", "'", '"', "=", "{}", "None", "\x1b[2J")
LENGTHS = (0, 1, 127, 255, 65535, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**62, 2**63 - 1, 2**64 - 1)
VALUES = (
    None,
    True,
    [],
    {},
    [[]],
    "",
    "..",
    "a\nb",
    -1,
    0,
    2**63,
    10**400,
    1e308,
    float("nan"),
    float("inf"),
    "9" * 400,
)
DEEP = 100_000  # of brackets in brackets


def broken_bytes(data, rng):
    """One to four changes: bits, a length, a part lost, doubled, emptied or put elsewhere, the end cut off."""
    data = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        if not data:
            break
        at, n = _place(data, rng), int(min(rng.integers(1, 1 + rng.choice([1, 8, 300])), len(data)))
        match int(rng.integers(0, 8)):
            case 0 | 1:
                data[at] ^= 1 << int(rng.integers(0, 8))
            case 2 | 3:
                value, form = (
                    LENGTHS[int(rng.integers(0, len(LENGTHS)))],
                    str(rng.choice(["<B", "<H", "<I", "<Q", ">I", ">H"])),
                )
                packed = struct.pack(form, value % (1 << 8 * struct.calcsize(form)))
                data[at : at + len(packed)] = packed
            case 4:
                del data[at : at + n]
            case 5:
                other = _place(data, rng)
                data[other:other] = data[at : at + n]
            case 6:
                data[at : at + n] = bytes(n)
            case 7 if rng.random() < 0.3:
                del data[at:]
    return bytes(data)


def _place(data, rng):
    """A byte; headers and ends are worth more attempts."""
    near = min(len(data), int(rng.choice([64, 600, len(data)])))
    at = int(rng.integers(0, near))
    return at if rng.random() < 0.7 else len(data) - 1 - at


def broken_text(data, rng):
    """One to four changes of words and lines; sometimes of bytes."""
    if rng.random() < 0.15:
        return broken_bytes(data, rng)
    lines = data.decode().split("\n")
    for _ in range(int(rng.integers(1, 5))):
        k = int(rng.integers(0, len(lines)))
        words = lines[k].split(" ")
        match int(rng.integers(0, 7)):
            case 0 | 1 | 2:
                words[int(rng.integers(0, len(words)))] = WORDS[int(rng.integers(0, len(WORDS)))]
                lines[k] = " ".join(words)
            case 3:
                lines[k] = " ".join(words[:-1])
            case 4:
                lines.insert(int(rng.integers(0, len(lines))), lines[k])
            case 5 if len(lines) > 1:
                del lines[k]
            case 6:
                lines[k] += str(rng.choice([" 1", "\r", " " * 3000, "\u2028", "# x"]))
    return "\n".join(lines).encode()


def broken_json(data, rng):
    """A value exchanged or lost, wherever it stands; sometimes brackets without an end, or bytes."""
    if rng.random() < 0.2:
        return broken_text(data, rng)
    if rng.random() < 0.05:
        return b"[" * DEEP + b"]" * DEEP
    if b"\n{" in data.strip():  # a value a line
        lines = data.splitlines()
        k = int(rng.integers(0, len(lines)))
        return b"\n".join([*lines[:k], broken_json(lines[k], rng), *lines[k + 1 :]])
    top = json.loads(data)
    for _ in range(int(rng.integers(1, 3))):
        top = _changed(top, rng)
    return json.dumps(top).encode()


def _changed(value, rng):
    if isinstance(value, dict | list) and value and rng.random() < 0.85:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = keys[int(rng.integers(0, len(keys)))]
        value = value.copy()
        if rng.random() < 0.1:
            del value[key]
        else:
            value[key] = _changed(value[key], rng)
        return value
    return VALUES[int(rng.integers(0, len(VALUES)))]


def broken_png(data, rng):
    """A PNG whose checksums fit what was changed: sizes that lie, data that are no image."""
    chunks, at = [], 8
    while at + 12 <= len(data):
        (n,) = struct.unpack_from(">I", data, at)
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + n]))
        at += 12 + n
    k = int(rng.integers(0, len(chunks)))
    kind, body = chunks[k]
    if kind == b"IHDR" and rng.random() < 0.7:
        width, height = (int(rng.choice([1, 31, 64, 30_000, 2**20, 2**31 - 1])) for _ in range(2))
        body = struct.pack(">II", width, height) + body[8:]
    else:
        body = broken_bytes(body, rng)
    chunks[k] = kind, body
    parts = [struct.pack(">I", len(b)) + t + b + struct.pack(">I", zlib.crc32(t + b)) for t, b in chunks]
    return data[:8] + b"".join(parts)
