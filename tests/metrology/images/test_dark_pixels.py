"""Dark pixels, made many at a time by vectors of any width, are those of the same sums one by one."""

import numpy as np
import pytest
from scipy.special import ndtri

from fiberloom._core import metrology

GAIN, READ_E = 1.3, 10.0
MOFFAT = 1
PARTS, TAIL_PARTS, PLACES = 2048, 8, 32
LANES = 8
WORD = (1 << 64) - 1


def splitmix(seed, n):
    """(n,) words of splitmix64."""
    out = []
    for _ in range(n):
        seed = (seed + 0x9E3779B97F4A7C15) & WORD
        z = (seed ^ seed >> 30) * 0xBF58476D1CE4E5B9 & WORD
        z = (z ^ z >> 27) * 0x94D049BB133111EB & WORD
        out.append(z ^ z >> 31)
    return np.array(out, dtype=np.uint64)


def turned(x, by):
    return x << np.uint64(by) | x >> np.uint64(64 - by)


def sixteen_bits(seed, n):
    """(n,) of xoshiro256++ in eight lanes (Blackman and Vigna 2018)."""
    s = list(splitmix(seed, 4 * LANES).reshape(4, LANES))
    words = []
    for _ in range(-(-n // (4 * LANES))):
        words.append(turned(s[0] + s[3], 23) + s[0])
        t = s[1] << np.uint64(17)
        s[2] = s[2] ^ s[0]
        s[3] = s[3] ^ s[1]
        s[1] = s[1] ^ s[2]
        s[0] = s[0] ^ s[3]
        s[2] = s[2] ^ t
        s[3] = turned(s[3], 45)
    return np.concatenate(words).astype("<u8").view("<u2")[:n].astype(int)


def normals(seed, n):
    """(n,) normal numbers, and which of them are of the tails, which are drawn otherwise."""
    edges = ndtri(np.arange(1, PARTS) / PARTS)
    density = np.concatenate([[0.0], np.exp(-0.5 * edges**2) / np.sqrt(2.0 * np.pi), [0.0]])
    mean = ((density[:-1] - density[1:]) * PARTS).astype(np.float32)
    width = np.diff(edges, prepend=0.0, append=0.0).astype(np.float32)
    bits = sixteen_bits(seed, n)
    part, place = bits // PLACES, ((bits % PLACES - 0.5 * (PLACES - 1)) / PLACES).astype(np.float32)
    tail = (part < TAIL_PARTS) | (part >= PARTS - TAIL_PARTS)
    return mean[part] + place * width[part], tail


def dark_row(sky, limits, seed, width):
    """(width,) ADU of a row without light, in single precision, and which of them are of the tails.

    `sky`: level, electrons, and growth to the right; `limits`: bias in ADU and full well in electrons.
    """
    (level_e, slope_e), (bias_adu, full_well_e) = sky, limits
    mean_e = level_e + slope_e * np.arange(width)
    variance = mean_e + READ_E**2
    third = mean_e / (6.0 * variance)
    base = (bias_adu + (mean_e - third) / GAIN).astype(np.float32)
    spread = (np.sqrt(variance) / GAIN).astype(np.float32)
    skew = (third / GAIN).astype(np.float32)
    z, tail = normals(seed, width)
    top = np.float32(np.clip(np.rint(bias_adu + full_well_e / GAIN), 0.0, 65535.0))
    return np.rint(np.clip(base + z * (spread + z * skew), np.float32(0.0), top)).astype(np.uint16), tail


@pytest.mark.parametrize("limits", [(500.0, 60_000.0), (500.0, 110.0), (-80.0, 60_000.0)])
@pytest.mark.parametrize("width", [64, 997])
def test_dark_pixels_are_those_of_the_same_sums_one_by_one(limits, width):
    seed, rows, sky = 12345, 40, (100.0, 0.02, 0.0)
    nothing = metrology.Lights(np.zeros((0, 7)), MOFFAT, 50.0, np.zeros(0, np.int64), np.zeros(0, np.float32))
    detector = (GAIN, READ_E, *limits)
    adu = metrology.expose_lights(nothing, (rows, width), sky, detector, seed, threads=1)
    for j in range(rows):
        of_row = (seed + 0x632BE59BD9B4E019 * (j + 1)) & WORD
        wanted, tail = dark_row(sky[:2], limits, of_row ^ WORD, width)
        np.testing.assert_array_equal(adu[j, ~tail], wanted[~tail])
    assert np.ptp(adu) > 20
