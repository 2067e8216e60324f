"""Mutated records and load profiles against their readers, from a fixed seed.

A mutation keeps the structure of the file (header, separators, quotes, numbers, stamps, Parquet's types and footer) and
breaks one to three places of it, since random bytes are refused before anything is read. A reader must read the file
or refuse it with one sentence that names it; anything else is a traceback.
"""

from __future__ import annotations

import random
import tempfile
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.signals import plausible_range, split_column
from hil.profile import ProfileError, read_profile
from hil.record import Record, RecordError, read_record

READ, REFUSED, UNCLEAR, IMPOSSIBLE, TRACEBACK = "read", "refused", "refused unclearly", "read wrongly", "traceback"
"""Outcomes. Unclear is a refusal that does not name the file or has more than one line; wrong is a record whose times
do not increase, or with a number that is infinite or outside the plausible range of its unit.
"""
KINDS = ("csv", "parquet", "profile")

CELLS = (
    *("", " ", "nan", "NaN", "inf", "-inf", "1e999", "9.9E+37", "-9999", "7999", "1e-400", "0x10", "1_000", "ERR"),
    *("1,5", "1.234", "1,234", "1.234.567", "1,234,567.8", "1.234,5", "1 234,5", "1'234", "\u22125", "\u0663"),
    *("2026-03-04", "2026-03-04T10:00:00Z", "04.03.2026 10:00", "3/4/26 1:00 PM", "10:00:00", "25:61", "46085.97917"),
    *("20260304100000", "1793613600", "1793613600000000000000", "1e300", '"', '""', "a\tb", "#", "=1+1", "T_tank_C"),
    *("12/31/9999 23:59:59", "0001-01-01", "99:99:99", "2026-02-30", "4 M\u00e4rz 2026", "true", "\ufeff1", "\x00"),
    *("+", ".", ",", "--", "1-", "\u00bd", "1e", "\n"),
)
LINES = (
    *("sep=;", "sep=,", "#comment", "", ";;;", ",,,", "TOA5,a,b,c", "TS,RN,,", "s,W,degC,%", '"unfinished', "\ufeff"),
    *("#datatype,string,long,double", "#group,false,false", "#default,_result,,", "time_s,T_tank_C", "0,1,2,3,4,5,6,7"),
)


@dataclass
class RecordOutcomes:
    """Outcomes of one reader: counts by outcome, and the first few files with a failure."""

    counts: Counter[str] = field(default_factory=Counter)
    examples: list[str] = field(default_factory=list)

    @property
    def failures(self) -> int:
        """Return the number of files that were neither read rightly nor refused with one sentence."""
        return self.counts[TRACEBACK] + self.counts[UNCLEAR] + self.counts[IMPOSSIBLE]


def fuzz_records(
    count: int, seed: int, *, kinds: tuple[str, ...] = KINDS, progress: Callable[[float], None] = lambda share: None
) -> dict[str, RecordOutcomes]:
    """Return by kind of file the outcomes of `count` mutated files of each kind."""
    pick = random.Random(seed)
    found = {}
    makers: dict[str, tuple[Callable[[random.Random], bytes], str, Callable[[Path], object]]] = {
        "csv": (mutated_csv, "csv", read_record),
        "parquet": (mutated_parquet, "parquet", read_record),
        "profile": (mutated_profile, "csv", read_profile),
    }
    with tempfile.TemporaryDirectory(prefix="hil-fuzz-") as folder, warnings.catch_warnings():
        warnings.simplefilter("error")  # A warning of numpy is an unchecked number.
        for at, kind in enumerate(kinds):
            make, suffix, read = makers[kind]
            path = Path(folder) / f"fuzzed.{suffix}"
            found[kind] = RecordOutcomes()
            for number in range(count):
                content = make(pick)
                path.write_bytes(content)
                outcome, said = _outcome(read, path)
                found[kind].counts[outcome] += 1
                if outcome not in (READ, REFUSED) and len(found[kind].examples) < 20:
                    found[kind].examples.append(f"{said} of {content[:300]!r}")
                if number % 500 == 0:
                    progress((at + number / count) / len(kinds))
    progress(1.0)
    return found


def _outcome(read: Callable[[Path], object], path: Path) -> tuple[str, str]:
    try:
        found = read(path)
    except (RecordError, ProfileError) as error:
        said = str(error)
        return (REFUSED if path.name in said and "\n" not in said and "\r" not in said else UNCLEAR), said
    except Exception as error:  # Every exception except the reader's own is a finding.
        return TRACEBACK, f"{type(error).__name__}: {error}"
    return (READ, "") if not isinstance(found, Record) or _possible(found) else (IMPOSSIBLE, str(found.messages))


def _possible(record: Record) -> bool:
    """Return True if times increase and every number is missing or in the plausible range of its unit.

    A range that the file itself declares is wider only where it says so, which the mutations do not.
    """
    if not np.isfinite(record.time_s).all() or not (np.diff(record.time_s) > 0.0).all():
        return False
    for name, values in record.columns.items():
        low, high = plausible_range((split_column(name) or ("", "1"))[1])
        known = values[~np.isnan(values)]
        if len(known) and not (known.min() >= low and known.max() <= high):
            return False
    return True


def mutated_csv(pick: random.Random) -> bytes:
    """Return the bytes of a record as a logger, a spreadsheet or a database writes it, with one to three mutations."""
    layout = pick.choice(("plain", *_LAYOUTS))
    text = _LAYOUTS[layout](pick.randint(1, 24), pick)
    return _broken(text, pick)


def mutated_profile(pick: random.Random) -> bytes:
    """Return the bytes of a load profile with one to three mutations."""
    rows = "".join(f"{600 * i},{pick.randint(0, 900)},{pick.randint(0, 100)}\n" for i in range(pick.randint(1, 8)))
    return _broken("# a profile\ntime_s,heater_power_W,pump_speed_pct\n" + rows, pick)


def _broken(text: str, pick: random.Random) -> bytes:
    mark = max(",;\t", key=text.count)
    lines = text.split("\n")
    content = b""
    for _ in range(pick.randint(1, 3)):
        kind = pick.choice(("cell", "cell", "cell", "column", "line", "drop", "twice", "swap", "cut", "mark", "bytes"))
        at = pick.randrange(len(lines))
        if kind == "cell":
            cells = lines[at].split(mark)
            cells[pick.randrange(len(cells))] = pick.choice(CELLS)
            lines[at] = mark.join(cells)
        elif kind == "column":
            which, cell = pick.randrange(max(lines[0].count(mark), 1) + 1), pick.choice(CELLS)
            for i, line in enumerate(lines[1:], start=1):
                cells = line.split(mark)
                if which < len(cells) and pick.random() < 0.9:
                    cells[which] = cell
                    lines[i] = mark.join(cells)
        elif kind == "line":
            lines.insert(at, pick.choice(LINES))
        elif kind == "drop" and len(lines) > 1:
            del lines[at]
        elif kind == "twice":
            lines.insert(at, lines[at])
        elif kind == "swap":
            other = pick.randrange(len(lines))
            lines[at], lines[other] = lines[other], lines[at]
        elif kind == "cut":
            lines = lines[: at + 1]
            lines[-1] = lines[-1][: pick.randrange(len(lines[-1]) + 1)]
        elif kind == "mark":
            to = pick.choice(",;\t| ")
            lines = [line.replace(mark, to) for line in lines]
        content = b"bytes" if kind == "bytes" else content
    out = bytearray(pick.choice(("\n", "\n", "\r\n", "\r")).join(lines).encode(errors="surrogatepass"))
    if content and out:
        for _ in range(pick.randint(1, 4)):
            out[pick.randrange(len(out))] = pick.randrange(256)
    return bytes(out) if pick.random() < 0.97 else b"\xef\xbb\xbf" + bytes(out)


def _plain(n: int, pick: random.Random) -> str:
    return "time_s,T_tank_C,heater_power_W,note\n" + "".join(
        f"{30 * i},{20 + i / 7:.3f},{pick.randint(0, 1500)},ok\n" for i in range(n)
    )


def _german(n: int, pick: random.Random) -> str:
    rows = (
        f"04.03.2026 10:{i:02}:00;{20 + i / 7:.2f};{pick.randint(0, 1500)}\n".replace(".", ",", 0) for i in range(n)
    )
    return "Datum;T_tank_C;heater_power_W\n" + "".join(row.replace("20.", "20,") for row in rows)


def _toa5(n: int, pick: random.Random) -> str:
    head = '"TOA5","x","CR1000"\n"TIMESTAMP","RECORD","T_tank"\n"TS","RN","Deg C"\n"","","Avg"\n'
    return head + "".join(f'"2026-03-04 10:{i:02}:00",{i},{20 + pick.random():.3f}\n' for i in range(n))


def _two_columns(n: int, pick: random.Random) -> str:
    return "Date,Time,T_tank_C\n" + "".join(
        f"{3 + i // 20}/4/2026,{(11 + i // 12) % 12 or 12}:{i * 5 % 60:02} PM,{20 + pick.random():.2f}\n"
        for i in range(n)
    )


def _long(n: int, pick: random.Random) -> str:
    names = ("sensor.tank", "sensor.heater")
    return "entity_id,state,last_changed\n" + "".join(
        f"{pick.choice(names)},{20 + pick.random():.2f},2026-03-04T10:{i:02}:00.5Z\n" for i in range(n)
    )


def _annotated(n: int, pick: random.Random) -> str:
    head = "#datatype,string,long,dateTime:RFC3339,double,string\n#group,false,false,false,false,true\n"
    head += "#default,_result,,,,\n,result,table,_time,_value,_field\n"
    return head + "".join(f",,0,2026-03-04T10:{i:02}:00Z,{20 + pick.random():.2f},T_tank_C\n" for i in range(n))


def _epoch(n: int, pick: random.Random) -> str:
    unit = pick.choice((1, 1000, 10**6, 10**9))
    return "timestamp,T1 [°C],x\n" + "".join(f"{(1_772_600_000 + i) * unit},{pick.random()},{i}\n" for i in range(n))


def _blanks(n: int, pick: random.Random) -> str:
    return "time_s   T_tank_C  W\n" + "".join(f"{i:6d} {20 + pick.random():9.3f}   {i}\n" for i in range(n))


def _labview(n: int, pick: random.Random) -> str:
    kind = pick.choice(("One", "Multi", "No"))
    text = f"LabVIEW Measurement\t\nDecimal_Separator\t.\nX_Columns\t{kind}\n***End_of_Header***\t\n"
    for begun in range(pick.randint(1, 3)):
        head = {"Channels": "2", "Date": "2026/03/04", "Time": f"10:{begun:02}:00.5", "Y_Unit_Label": "Deg C"}
        head |= {"X_Dimension": "Time", "X0": "0.0E+0", "Delta_X": "1.000000"}
        apart = "\t\t" if kind == "Multi" else "\t"
        text += "\n" + "".join(f"{tag}\t{value}{apart}{value}\n" for tag, value in head.items())
        text += "***End_of_Header***\nX_Value\tT_tank" + apart.replace("\t\t", "\tX_Value\t") + "T_room\tComment\n"
        for i in range(n):
            x = "" if kind == "No" else f"{i}.000000"
            text += f"{x}\t{20 + pick.random():.6f}\t" + (f"{x}\t" if kind == "Multi" else "") + "21.000000\n"
    return text


def _seconds_of_day(n: int, pick: random.Random) -> str:
    return "Date,Seconds,T_tank_C\n" + "".join(
        f"2026-03-{4 + (86000 + 100 * i) // 86400:02},{(86000 + 100 * i) % 86400},{20 + pick.random():.2f}\n"
        for i in range(n)
    )


_LAYOUTS: dict[str, Callable[[int, random.Random], str]] = {
    "plain": _plain,
    "german": _german,
    "toa5": _toa5,
    "two columns": _two_columns,
    "long": _long,
    "annotated": _annotated,
    "epoch": _epoch,
    "blanks": _blanks,
    "labview": _labview,
    "seconds of the day": _seconds_of_day,
}


def mutated_parquet(pick: random.Random) -> bytes:
    """Return the bytes of a Parquet file: columns of any type, sizes and names, and in a third of them broken bytes."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    n = pick.randint(0, 12)
    names = ["time_s", "T_tank_C", "T_tank_C_quality", "Date", "Time", "value", "name", "T_in_K", "x", "", "timestamp"]
    columns, given = [], []
    if pick.random() < 0.7:
        columns, given = [pa.array([30.0 * i for i in range(n)])], [pa.field("time_s", pa.float64())]
    for name in pick.sample(names, pick.randint(1, 6)):
        column = _column(pick, n)
        told = {b"unit": pick.choice((b"s", b"degC", b"\xff\xfe", b""))} if pick.random() < 0.3 else {}
        told |= {b"plausible": pick.choice((b"[0, 50]", b"[1", b"null", b"[2, 1]"))} if pick.random() < 0.2 else {}
        columns.append(column)
        given.append(pa.field(pick.choice((name, name, "T_tank_C")), column.type, metadata=told))
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.Table.from_arrays(columns, schema=pa.schema(given)), sink, compression=pick.choice(("zstd", "none"))
    )
    out = bytearray(sink.getvalue().to_pybytes())
    kind = pick.random()
    if kind < 0.2:
        for _ in range(pick.randint(1, 3)):
            out[pick.randrange(len(out))] = pick.randrange(256)
    elif kind < 0.27:
        out = out[: pick.randrange(len(out))] + (b"PAR1" if pick.random() < 0.5 else b"")
    elif kind < 0.33:
        at = pick.randrange(len(out))
        out[at:at] = pick.randbytes(pick.randint(1, 40))
    return bytes(out)


def _column(pick: random.Random, n: int) -> Any:
    import pyarrow as pa

    def some(make: Callable[[], Any]) -> list[Any]:
        return [None if pick.random() < 0.1 else make() for _ in range(n)]

    whole = some(lambda: pick.choice((0, 1, pick.randrange(10**6), -9999, 2**53 + 1)))
    makers: tuple[Callable[[], Any], ...] = (
        lambda: pa.array([30.0 * i for i in range(n)]),
        lambda: pa.array(some(lambda: pick.choice((20.5, 9.9e37, float("nan"), float("inf"), -1e308, 1e-320)))),
        lambda: pa.array(whole, pa.int64()),
        lambda: pa.array(some(lambda: pick.choice((0, 2**63, 2**64 - 1))), pa.uint64()),
        lambda: pa.array(some(lambda: pick.choice((True, False)))),
        lambda: pa.array(some(lambda: pick.choice(CELLS).replace("\x00", "")), pa.string()),
        lambda: pa.array(some(lambda: pick.choice(("1,5", "1.234", "20"))), pa.large_string()),
        lambda: pa.array(some(lambda: pick.choice(("a", "b"))), pa.string()).dictionary_encode(),
        lambda: pa.array(whole, pa.timestamp(pick.choice(("s", "ms", "us", "ns")), pick.choice((None, "UTC")))),
        lambda: pa.array(some(lambda: pick.choice((2**62, -(2**62), 0))), pa.timestamp(pick.choice(("ms", "us")))),
        lambda: pa.array(whole, pa.duration(pick.choice(("s", "ns")))),
        lambda: pa.array(some(lambda: pick.randrange(86_400)), pa.time32("s")),
        lambda: pa.array(some(lambda: pick.choice((0, 20_000, 2**31 - 1))), pa.date32()),
        lambda: pa.array(some(lambda: [1, 2]), pa.list_(pa.int64())),
        lambda: pa.array(some(lambda: {"a": 1}), pa.struct([("a", pa.int64())])),
        lambda: pa.array(some(lambda: b"\xff"), pa.binary()),
        lambda: pa.array([None] * n, pa.null()),
        lambda: pa.array(some(lambda: 1), pa.decimal128(10, 2)),
        lambda: pa.array(some(lambda: 1.5), pa.float16()) if n == 0 else pa.array([1.5] * n, pa.float32()),
    )
    return pick.choice(makers)()
