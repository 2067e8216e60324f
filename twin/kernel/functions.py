"""Functions that generated kernels call, as text: they are compiled beside each kernel, for its number of lanes.

LANES, SLOTS, NEVER, PER_STEP, PER_STABLE and DECAYED are constants of the generated module.
"""

import math

EXP = '''
@inlined
def exp(x):
    """exp(x) by halving, a Taylor polynomial and squaring: no call, so the lane loop stays vectorised."""
    y = min(max(x, -60.0), 60.0) * 0.00390625
    y = 1.0 + y * (1.0 + y * (0.5 + y * (1.0 / 6.0 + y * (1.0 / 24.0 + y * (1.0 / 120.0 + y / 720.0)))))
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return y * y
'''
_HALVINGS = "\n".join(
    f"    e = e + {k}.0 if y >= {2.0**k!r} else e\n    y = y * {2.0**-k!r} if y >= {2.0**k!r} else y"
    for k in (512, 256, 128, 64, 32, 16, 8, 4, 2, 1)
)
_SERIES = " + q * (".join(repr(1.0 / k) for k in range(1, 21, 2)) + ")" * 9
LOG = f'''
@inlined
def log(x):
    """log(x) of a positive number by halving and the series of artanh: no call, so the lane loop stays vectorised."""
    e = -1023.0 if x < 1.0 else 0.0
    y = x * {2.0**1023!r} if x < 1.0 else x
{_HALVINGS}
    e = e + 1.0 if y > {math.sqrt(2.0)!r} else e
    y = y * 0.5 if y > {math.sqrt(2.0)!r} else y
    s = (y - 1.0) / (y + 1.0)
    q = s * s
    return e * {math.log(2.0)!r} + 2.0 * s * ({_SERIES})
'''
SUBSTEPS = '''
@inlined
def substeps(x, norm):
    """Return the least substeps, not rounded, for the largest own rate and the norm of rates, times the interval."""
    return max(min(x * PER_STEP, DECAYED), min(norm * PER_STABLE, x * PER_STEP))
'''
ARRIVED = '''
@typed('f8(f8[::1], f8[:,::1], i8, i8, f8)')
def arrived(time, inputs, column, i, dead):
    """Return the mean of a held input over interval i, `dead` seconds ago; before the first sample it was constant."""
    first, last = time[i] - dead, time[i + 1] - dead
    low, high = 0, i
    while low < high:
        middle = (low + high + 1) // 2
        if time[middle] <= first:
            low = middle
        else:
            high = middle - 1
    if last <= first:
        return inputs[low, column]
    total, at = 0.0, first
    while low < i and time[low + 1] < last:
        total += inputs[low, column] * max(time[low + 1] - at, 0.0)
        at = max(time[low + 1], at)
        low += 1
    return (total + inputs[low, column] * (last - at)) / (last - first)
'''
DELAY_STATE = '''
@typed('void(f8[:,::1], f8[:,:,::1], i8, i8, i8)')
def fill_volumes(V, past, b, line, row):
    """Set the volumes of a flow at which its slots begin, from now; at rest all but the last slots are far away."""
    for e in range(SLOTS):
        for l in range(V.shape[1]):
            V[line + e, l] = past[b, row + e, l] if past.shape[0] > 0 else (e - SLOTS + 1) * NEVER


@typed('void(f8[:,::1], f8[:,::1], f8[:,:,::1], i8, i8, i8, i8)')
def fill_water(H, R, past, b, line, row, water):
    """Set the water of a delay, slot by slot; at rest it is that in row `water`."""
    for e in range(SLOTS):
        for part in range(3):
            for l in range(LANES):
                rest = R[water, l] if part == 0 else 0.0
                H[3 * (line + e) + part, l] = past[b, row + part * SLOTS + e, l] if past.shape[0] > 0 else rest


@typed('void(f8[:,::1], f8[:,:,::1], i8, i8, i8, i8, i8)')
def hand_volumes(V, future, b, line, row, tip, since):
    """Store the volumes for `fill_volumes`, oldest slot first, from the newest boundary; then steps since closing."""
    many = V.shape[1] > 1
    for l in range(LANES):
        own = l if many else 0
        for e in range(SLOTS):
            future[b, row + e, l] = V[line + ((tip + 1 + e) & (SLOTS - 1)), own] - V[line + tip, own]
        future[b, row + SLOTS, l] = since


@typed('void(f8[:,::1], f8[:,:,::1], i8, i8, i8, i8)')
def hand_water(H, future, b, line, row, tip):
    """Store the water for `fill_water`."""
    for e in range(SLOTS):
        for part in range(3):
            for l in range(LANES):
                future[b, row + part * SLOTS + e, l] = H[3 * (line + ((tip + 1 + e) & (SLOTS - 1))) + part, l]
'''
_NOTE = '''
@typed('void(f8[:,::1], f8[:,::1], i8, i8, i8, {type})')
def note(H, R, i, water, steps, share):
    """Fill slot i from the rows of R: water that enters at the start, its slope there, water at the end.

    The step takes up the share of the slot's volume.
    """
    i = 3 * i
    if steps == 0:
        for l in range(LANES):  # one row to a loop: few rows to prove apart, and it stays vectorised
            H[i, l] = R[water, l]
        for l in range(LANES):
            H[i + 1, l] = R[water + 1, l]
        for l in range(LANES):
            H[i + 2, l] = R[water + 2, l] - R[water, l] - R[water + 1, l]
    else:
        for l in range(LANES):
            new = 2.0 / 3.0 * R[water, l] + 1.0 / 6.0 * R[water + 1, l] + 1.0 / 3.0 * R[water + 2, l]
            mean = H[i, l] + 0.5 * H[i + 1, l] + 1.0 / 3.0 * H[i + 2, l]
            mean += {share} * (new - mean)
            H[i + 1, l] = 6.0 * mean - 4.0 * H[i, l] - 2.0 * R[water + 2, l]
            H[i + 2, l] = R[water + 2, l] - H[i, l] - H[i + 1, l]
'''


def _note(kind: str, share: str) -> str:
    """Return the function that fills a slot, for a share of the slot's volume of a type and an expression."""
    return _NOTE.replace("{type}", kind).replace("{share}", share)


SHARED_FLOW = (
    _note("f8", "share")
    + '''

@typed('i8(f8[:,::1], f8[:,::1], f8[:,::1], i8, i8, i8, f8, f8, i8, i8)')
def look(V, H, R, flow, line, s, y, span, tip, out):
    """Write the water from volume y to y + span as a quadratic in time into rows from `out`; return y's slot."""
    while s != ((tip + 1) & (SLOTS - 1)) and V[flow + s, 0] > y:
        s = (s - 1) & (SLOTS - 1)
    while ((s + 1) & (SLOTS - 1)) != tip and V[flow + ((s + 1) & (SLOTS - 1)), 0] <= y:
        s = (s + 1) & (SLOTS - 1)
    cursor, low, high, keep = s, 0.0, 0.0, 0.0
    while high < 1.0:
        after = (s + 1) & (SLOTS - 1)
        begin, end = V[flow + s, 0], V[flow + after, 0]
        one = 1.0 / max(end - begin, 1e-12)
        high = 1.0 if after == tip else min(max((end - y) / span, low), 1.0)
        c = min(max((y + low * span - begin) * one, 0.0), 1.0)
        d = min(max((y + high * span - begin) * one, 0.0), 1.0) - c
        w = high - low
        # Integrals over the part of 1, t, t^2 times r^0, r, r^2 with r = c + d t, then of powers of the share.
        cc, cd, dd = c * c, 2.0 * c * d, d * d
        a0, a1, a2 = 1.0, 0.5, 1.0 / 3.0
        m0, m1, m2 = c + d / 2.0, c / 2.0 + d / 3.0, c / 3.0 + d / 4.0
        b0, b1, b2 = cc + cd / 2.0 + dd / 3.0, cc / 2.0 + cd / 3.0 + dd / 4.0, cc / 3.0 + cd / 4.0 + dd / 5.0
        a2 = w * (low * low * a0 + w * (2.0 * low * a1 + w * a2))
        m2 = w * (low * low * m0 + w * (2.0 * low * m1 + w * m2))
        b2 = w * (low * low * b0 + w * (2.0 * low * b1 + w * b2))
        a1, m1, b1 = w * (low * a0 + w * a1), w * (low * m0 + w * m1), w * (low * b0 + w * b1)
        a0, m0, b0 = w * a0, w * m0, w * b0
        ax, mx = 9.0 * a0 - 36.0 * a1 + 30.0 * a2, 9.0 * m0 - 36.0 * m1 + 30.0 * m2
        bx = 9.0 * b0 - 36.0 * b1 + 30.0 * b2
        ay = -36.0 * a0 + 192.0 * a1 - 180.0 * a2
        my = -36.0 * m0 + 192.0 * m1 - 180.0 * m2
        by = -36.0 * b0 + 192.0 * b1 - 180.0 * b2
        az, mz, bz = 30.0 * a0 - 180.0 * (a1 - a2), 30.0 * m0 - 180.0 * (m1 - m2), 30.0 * b0 - 180.0 * (b1 - b2)
        at = 3 * (line + s)
        for l in range(LANES):
            R[out, l] = keep * R[out, l] + (ax * H[at, l] + mx * H[at + 1, l] + bx * H[at + 2, l])
        for l in range(LANES):
            R[out + 1, l] = keep * R[out + 1, l] + (ay * H[at, l] + my * H[at + 1, l] + by * H[at + 2, l])
        for l in range(LANES):
            R[out + 2, l] = keep * R[out + 2, l] + (az * H[at, l] + mz * H[at + 1, l] + bz * H[at + 2, l])
        low, keep, s = high, 1.0, after
    return cursor
'''
)
SEPARATE_FLOW = (
    _note("i8", "R[share, l]")
    + '''

@typed('i8(f8[:,::1], f8[:,::1], f8[:,::1], i8, i8, i8, i8, i8, i8)')
def look(V, H, R, flow, line, s, place, tip, out):
    """Write each lane's water from volume y = R[place] to y + R[place + 1] as a quadratic in time into rows from `out`.

    Return a slot that begins at or before every lane's y.
    """
    while s != ((tip + 1) & (SLOTS - 1)):
        over = 0
        for l in range(LANES):
            over += int(V[flow + s, l] > R[place, l])
        if over == 0:
            break
        s = (s - 1) & (SLOTS - 1)
    while ((s + 1) & (SLOTS - 1)) != tip:
        over, after = 0, (s + 1) & (SLOTS - 1)
        for l in range(LANES):
            over += int(V[flow + after, l] > R[place, l])
        if over > 0:
            break
        s = after
    cursor, first, more = s, 0.0, 1
    while more > 0:
        after = (s + 1) & (SLOTS - 1)
        last = 1.0 if after == tip else 0.0
        at, more = 3 * (line + s), 0
        for l in range(LANES):
            y, span = R[place, l], R[place + 1, l]
            begin, end = V[flow + s, l], V[flow + after, l]
            one = 1.0 / max(end - begin, 1e-12)
            low = first * min(max((begin - y) / span, 0.0), 1.0)
            high = max(min(max((end - y) / span, 0.0), 1.0), last)
            c = min(max((y + low * span - begin) * one, 0.0), 1.0)
            d = min(max((y + high * span - begin) * one, 0.0), 1.0) - c
            w = high - low
            a, m, b = H[at, l], H[at + 1, l], H[at + 2, l]
            a, m, b = a + c * (m + c * b), d * (m + 2.0 * c * b), d * d * b
            m0 = a + m / 2.0 + b / 3.0
            m1 = a / 2.0 + m / 3.0 + b / 4.0
            m2 = a / 3.0 + m / 4.0 + b / 5.0
            m2 = w * (low * low * m0 + w * (2.0 * low * m1 + w * m2))
            m1 = w * (low * m0 + w * m1)
            m0 = w * m0
            R[out, l] = first * R[out, l] + (9.0 * m0 - 36.0 * m1 + 30.0 * m2)
            R[out + 1, l] = first * R[out + 1, l] + (192.0 * m1 - 36.0 * m0 - 180.0 * m2)
            R[out + 2, l] = first * R[out + 2, l] + (30.0 * m0 - 180.0 * (m1 - m2))
            more += int(high < 1.0)
        first, s = 1.0, after
    return cursor
'''
)
PIECES = '''
@typed('void(f8[::1], f8[:,:,:,::1], f8[:,:,::1], f8[:,:,::1], i8[::1], f8[::1], f8[:,::1], f8[:,:,:,::1], '
       'f8[:,:,::1], f8[:,:,::1])')
def kernel(base, lanes, start, past, cuts, time, inputs, Y, end, future):
    """Simulate one piece after the other, each from the end of the one before; both read the sample at a cut."""
    n = time.shape[0]
    for c in range(lanes.shape[0]):
        piece(base, lanes[c], start, past, cuts[c], min(cuts[c + 1] + 1, n), time, inputs, Y, end, future)
        start, past = end, future
'''
