"""The catalogue that Starmesh ships, read by the description of its format (common/imaging/src/catalogue.rs)."""

import pathlib

import numpy as np

FILE = pathlib.Path(__file__).resolve().parents[2] / "catalogue" / "default.smcat"


def every_other_bit(value: np.ndarray) -> np.ndarray:
    """`xaybzc` becomes `abc`."""
    value = value & 0x5555_5555
    for shift, mask in [(1, 0x3333_3333), (2, 0x0F0F_0F0F), (4, 0x00FF_00FF), (8, 0x0000_FFFF)]:
        value = (value | value >> shift) & mask
    return value


def stars() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right ascension and declination (deg, ICRS, at the catalogue's epoch) and magnitude of all stars."""
    data = FILE.read_bytes()
    assert data[:8] == b"SMCAT\0\0\x01"
    order, count, _, _ = np.frombuffer(data, "<u4", 4, 8)
    cells = 12 * 4 ** int(order)
    index = np.frombuffer(data, "<u4", cells + 1, 32)
    records = np.frombuffer(data, "<u4", 2 * int(count), 32 + 4 * (cells + 1)).reshape(-1, 2)
    cell = np.repeat(np.arange(cells), np.diff(index.astype(np.int64)))
    # a cell is a face and (x, y) on it, its bits interleaved; a record says where in the cell
    face, within, side = cell >> 2 * int(order), cell & 4 ** int(order) - 1, 2.0 ** int(order)
    x = (every_other_bit(within) + ((records[:, 0] & 0xFFFF) + 0.5) / 65536) / side
    y = (every_other_bit(within >> 1) + ((records[:, 0] >> 16) + 0.5) / 65536) / side
    # Gorski et al. 2005, ApJ 622, 759, section 5: rings from the north pole (0) to the south pole (4)
    down = 2 + face // 4 - x - y
    ring = np.minimum(np.minimum(down, 4 - down), 1)
    polar = 1 - ring**2 / 3
    sin_dec = np.where(down < 1, polar, np.where(down > 3, -polar, (2 - down) * 2 / 3))
    eighths = 2 * (face % 4) + (face // 4 != 1) + (x - y) / ring
    return eighths * 45 % 360, np.degrees(np.arcsin(sin_dec)), (records[:, 1] & 0x3FF) * 0.02 - 2
