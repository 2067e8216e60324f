"""Page `diagnosis.html`: one self-contained file, made from the results folder."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hil.diagnosis.page.figures import pictures
from hil.diagnosis.store import PAGE, Findings, read_findings
from hil.diagnosis.wording import after_label, ambiguity_group, at_rest, grown, likeness, plain, reasons
from hil.files import Html, document, element, image, joined, replacing

PAGE_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68rem; margin: 2rem auto; padding: 0 1rem; color: #22262b }
h1 { font-size: 1.05rem; font-weight: 600; color: #5b636b; margin-bottom: .6rem }
h2 { font-size: 1.15rem; margin: 2.4rem 0 .3rem } h3 { font-size: 1rem; margin: 1.6rem 0 .2rem }
img { width: 100%; display: block }
.verdict { border-left: .5rem solid #0072B2; background: #f3f6f9; padding: .9rem 1.2rem }
.verdict b { text-transform: uppercase; letter-spacing: .06em; font-size: .85rem }
.verdict p { font-size: 1.15rem; margin: .3rem 0 0 }
.adequate { border-color: #009E73 } .ambiguous { border-color: #E69F00 } .unexplained { border-color: #D55E00 }
.cards { display: flex; flex-wrap: wrap; gap: .8rem; margin: 1rem 0 }
.cards div { flex: 1 1 10rem; border: 1px solid #d8dce0; border-radius: .4rem; padding: .5rem .8rem }
.cards span { color: #5b636b; font-size: .82rem; display: block } .cards b { font-size: 1.15rem }
.cards i { font-style: normal; color: #5b636b; font-size: .85rem; display: block }
table { border-collapse: collapse; font-size: .92rem; margin: .5rem 0 }
td, th { padding: .25rem .8rem .25rem 0; border-bottom: 1px solid #d8dce0; text-align: left; vertical-align: top }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums } tr.far td { font-weight: 600 }
td { overflow-wrap: anywhere } th { color: #5b636b; font-weight: 600 }
p.note { color: #5b636b; font-size: .9rem; margin: .2rem 0 .4rem } p.warn { color: #8a5a00; font-weight: 600 }
nav { font-size: .9rem; margin: .6rem 0 } nav a { color: #0072B2; margin-right: 1rem }
@media screen and (prefers-color-scheme: dark) {
h1, .cards span, .cards i, th { color: #9aa4ae } .verdict { background: #1e242b } .cards div { border-color: #3a4149 }
p.warn { color: #f0b429 } nav a { color: #8ab4f8 }
}
@media print { h2 { break-after: avoid } img { break-inside: avoid } nav { display: none } }
"""
_FAR_SD = 3.0
NOTHING = joined([])


def write_page(folder: Path) -> Path:
    """Write `diagnosis.html` from the folder's results; raise DiagnosisFolderError if there are none."""
    path = folder / PAGE
    text = page(read_findings(folder))
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return path


def page(findings: Findings) -> str:
    """Return the whole page as HTML."""
    d = findings.document
    drawn = pictures(findings)
    subject = Path(str(d.get("record") or "record"))
    title = f"Diagnosis of {subject.parent.name}/{subject.name}" if subject.parent.name else subject.name
    body = [
        element("h1", title),
        _origin(d),
        _verdict(d),
        _cards(d),
        _leads(d),
        _read(d),
        _experiment(d),
        _section("Residual", drawn, "residuals", _residual_note(d)),
        _section("Unknown input by place", drawn, "unknowns", _UNKNOWN_NOTE),
        _significance(d, drawn),
        _section("Evidence", drawn, "ladder", _LADDER_NOTE),
        _section("Explanations", drawn, "others", _others_note(d)),
        _section("Error on held-out data", drawn, "errors", _errors_note(d)),
        _section(
            "Parameter changes by re-tuning alone", drawn, "tunables", _TUNABLES_NOTE if not grown(d) else _GROWN_NOTE
        ),
        element("h2", "Tables"),
        _effects(d),
        _alternatives(d),
        _error_table(d),
        _further_tables(d),
        _tunable_table(d),
        _lists(d),
        _provenance(d),
    ]
    return document(title, PAGE_STYLE, body)


def _note(text: str) -> Html:
    return element("p", text, class_="note")


_UNKNOWN_NOTE = (
    "These estimates use no catalogue of effects. Each curve is the power (or thermometer error, or change of "
    "radiator heat or of flow) that explains the record if it acts at that place alone. "
    "The likeliest places come first; the likeliest one is blue."
)
_LEADS_NOTE = (
    "Where to look in what is left unexplained. Noise alone gives a lead of one kind in one record of a hundred."
)
_LADDER_NOTE = (
    "Left: misfit of the twin with each added effect; the dotted line is noise alone. Right: "
    "score statistic of the best next effect."
)
_HIDDEN_NOTE = (
    "Cross-validation: each fold is predicted from a fit to the others. Bars: gain of the effects over "
    "re-tuning alone (fall of weighted squares). Red: worse."
)
_BLOCKS_NOTE = (
    "Cross-validation: each fold is predicted from a fit to the rest, less the rig's memory on either side. Bars: "
    "gain over the better of baseline and re-tuned twin (fall of weighted squares). Red: "
    "worse. A fold has no bar if the sizes are not identifiable from the rest."
)
_TUNABLES_NOTE = (
    "A twin without the effect imitates it by moving its own parameters. A value far outside the grey band "
    "contradicts commissioning."
)


_GROWN_NOTE = (
    "A twin without the effects imitates them by moving its own parameters. The twin was never commissioned, so "
    "the grey band is only the prior of the twin file's values."
)


def _residual_note(d: dict[str, Any]) -> str:
    band = "the noise of the thermometers" if grown(d) else "the residual of a healthy rig"
    run = "twin at rest" if at_rest(d) else "free-running twin"
    return f"Measured minus the {run}. The grey band is {band}. Right: the same {after_label(d)}, on its own scale."


def _others_note(d: dict[str, Any]) -> str:
    if ambiguity_group(d):
        text = "Orange: ambiguity group of the answer, which this record does not distinguish. Grey: rejected. "
    else:
        text = "Explanations that were tested, and the reason for their rejection. "
    return text + "The answer's confidence is that of its kind and place, over all drivers."


def _errors_note(d: dict[str, Any]) -> str:
    if at_rest(d):
        return (
            "Scored on every fourth steady state, which was split off before any fit. Re-tuned: the twin's own "
            "parameters fitted anew without any new term, so that re-tuning is not credited to the effect."
        )
    low, high = (_hours(s) for s in d["error"]["held_out_s"])
    return (
        f"Free runs, never one step ahead; scored from {low} to {high}, which was split off before any fit. Re-tuned: "
        "the twin's own parameters fitted anew without any new term, so that re-tuning is not credited to the effect."
    )


def _section(title: str, drawn: dict[str, str], name: str, note: str) -> Html:
    if name not in drawn:
        return NOTHING
    picture = image("svg+xml", drawn[name].encode(), title or name, name)
    return joined([*([element("h2", title)] if title else []), _note(note), picture])


def _significance(d: dict[str, Any], drawn: dict[str, str]) -> Html:
    """Render significance and cross-validation of the answer."""
    sentences = joined(element("p", text) for text in reasons(d))
    blocks = _section("", drawn, "blocks", _HIDDEN_NOTE if grown(d) else _BLOCKS_NOTE)
    return (
        joined([element("h2", "Significance and cross-validation"), sentences, blocks])
        if sentences or blocks
        else NOTHING
    )


def _verdict(d: dict[str, Any]) -> Html:
    name = str(d["verdict"])
    kind = name.replace(" ", "-")
    return joined(
        [
            element("div", element("b", name), element("p", d["summary"]), class_=f"verdict {kind}"),
            *(element("p", text, class_="warn") for text in d["warnings"]),
            *(_note(text) for text in d["notes"]),
        ]
    )


def _origin(d: dict[str, Any]) -> Html:
    """Render the twin with its hash, and the version of hil; nothing where they are not recorded."""
    about = d.get("provenance") or {}
    twin = about.get("files", {}).get("twin")
    rows = []
    if twin is not None:
        rows.append(["twin", f"{twin['path']} (sha256 {twin['sha256'][:16]})"])
    if "hil" in about.get("versions", {}):
        rows.append(["made by", f"hil {about['versions']['hil']}"])
    return _table(["", ""], rows) if rows else NOTHING


def _read(d: dict[str, Any]) -> Html:
    """Render the messages of the record's reader."""
    items = [element("li", message) for message in d.get("read") or ()]
    return joined([element("h2", "Reading the record"), element("ul", *items)]) if items else NOTHING


def _leads(d: dict[str, Any]) -> Html:
    """Render the leads: where to look in what is left unexplained."""
    items = [element("li", lead["says"]) for lead in d.get("leads") or ()]
    return joined([element("h2", "Leads"), _note(_LEADS_NOTE), element("ul", *items)]) if items else NOTHING


def _cards(d: dict[str, Any]) -> Html:
    cards: list[tuple[str, str, str]] = []
    for e in d["effects"]:
        low, high = e["interval90"]
        size, spread = _sized(e), f"90 %: {_number(low)} to {_number(high)}"
        since = _hours(e["onset_s"]) if e["onset_s"] > 60.0 else "the beginning"
        if len(d["effects"]) > 1:
            cards.append((plain(e), size, spread if at_rest(d) else f"since {since}; {spread}"))
            continue
        cards.append(("Size", size, spread))
        cards.append(("Place", e["where"].replace("_", " "), f"{e['kind']}, {e['driver']}".replace("_", " ")))
        early, late = e["onset_interval90_s"]
        if not at_rest(d):
            cards.append(("Onset", since, f"90 %: {_between(early, late)}" if late > early else e["shape"]))
    sensors = d["error"]["sensors"]
    if sensors:
        worst = max(sensors, key=lambda name: (sensors[name]["before"] or 0.0) / (sensors[name]["noise"] or 1.0))
        e = sensors[worst]
        value, comparison = f"{_number(e['stale'])} K", f"re-tuned {_number(e['before'])}"
        if after_label(d) == "with the effect":
            value, comparison = f"{_number(e['before'])} → {_number(e['after'])} K", f"baseline {_number(e['stale'])}"
        cards.append((f"{worst}, held out", value, f"{comparison}, noise {_number(e['noise'])} K"))
    cells = (element("div", element("span", a), element("b", b), element("i", c)) for a, b, c in cards)
    return element("div", *cells, class_="cards") if cards else NOTHING


def _table(head: list[str], rows: list[list[str]], numbers: int = 0, far: tuple[bool, ...] = ()) -> Html:
    """Render a table; the last `numbers` columns are right-aligned, rows marked `far` are bold."""
    first = len(head) - numbers

    def cells(tag: str, row: list[str]) -> list[Html]:
        return [element(tag, cell, class_="n" if i >= first else "") for i, cell in enumerate(row)]

    marks = far or (False,) * len(rows)
    lines = (
        element("tr", *cells("td", row), class_="far" if mark else "") for row, mark in zip(rows, marks, strict=True)
    )
    return element("table", element("tr", *cells("th", head)), *lines)


def _effects(d: dict[str, Any]) -> Html:
    if not d["effects"]:
        return NOTHING
    rows = []
    for e in d["effects"]:
        low, high = e["interval90"]
        early, late = e["onset_interval90_s"]
        rows.append(
            [
                e["kind"].replace("_", " "),
                e["where"],
                e["driver"].replace("_", " "),
                e["change"],
                e["shape"],
                _sized(e),
                f"{_number(low)} to {_number(high)}",
                _hours(e["onset_s"]),
                _between(early, late),
                _number(e["confidence"]),
                _number(e["z"]),
            ]
        )
    head = ["kind", "place", "driver", "change", "shape", "size", "90 %", "onset", "90 %", "confidence", "z"]
    return joined([element("h3", "Effects"), _table(head, rows, 6), *(_note(e["evidence"]) for e in d["effects"])])


def _alternatives(d: dict[str, Any]) -> Html:
    rows = [[plain(a), _share(a), likeness(d, a)] for a in ambiguity_group(d)]
    rows += [[plain(a), _share(a), a["why_not"]] for a in d["alternatives"]]
    head = ["explanation", "confidence", "reason for rejection"]
    return joined([element("h3", "Other explanations"), _table(head, rows)]) if rows else NOTHING


def _share(a: dict[str, Any]) -> str:
    share = a["confidence"] or 0.0
    return f"{100.0 * share:.0f} %" if share >= 0.005 else "0" if share == 0.0 else "< 1 %"


def _error_table(d: dict[str, Any]) -> Html:
    kinds = {"stale": "baseline", "before": "re-tuned"}
    if after_label(d) != "re-tuned":
        kinds["after"] = after_label(d)
    return _errors("RMSE in K, held out", d["error"]["sensors"], kinds)


def _further_tables(d: dict[str, Any]) -> Html:
    """Render errors over further records, with the diagnosed twin only if one was made."""
    kinds = {"stale": "baseline", "before": "re-tuned"}
    if d["verdict"] == "effect found":
        kinds["after"] = after_label(d)
    return joined(
        _errors(f"RMSE in K, {one['record']}, all of it", one["sensors"], kinds) for one in d.get("further_records", ())
    )


def _errors(title: str, sensors: dict[str, Any], kinds: dict[str, str]) -> Html:
    rows = []
    for name, e in sensors.items():
        means = e["ten_second_means"]
        cells = [e[k] for k in kinds] + [e["noise"]] + [means[k] for k in kinds]
        rows.append([name, *(_number(cell) for cell in cells)])
    head = ["sensor", *kinds.values(), "noise", *(f"{label}, 10 s means" for label in kinds.values())]
    return joined([element("h3", title), _table(head, rows, len(head) - 1)]) if rows else NOTHING


def _tunable_table(d: dict[str, Any]) -> Html:
    with_answer = after_label(d) != "re-tuned"
    rows, far = [], []
    for m in d["tunables_moved"]:
        rows.append(
            [
                m["parameter"],
                m["unit"],
                _number(m["commissioned"]),
                _number(m["before"]),
                _number(m["before_sd"], "+.1f"),
                *((_number(m["after"]), _number(m["after_sd"], "+.1f")) if with_answer else ()),
            ]
        )
        far.append(max(abs(m["before_sd"] or 0.0), abs(m["after_sd"] or 0.0)) > _FAR_SD)
    head = ["parameter", "unit", "in the twin file" if grown(d) else "commissioned", "re-tuned alone", "in sd"]
    head += [after_label(d), "in sd"] if with_answer else []
    shown = _table(head, rows, len(head) - 2, tuple(far))
    note = _note("Bold: more than three standard deviations.")
    return joined([element("h3", "Tunables"), shown, note]) if rows else NOTHING


def _lists(d: dict[str, Any]) -> Html:
    parts: list[Html] = []
    if d["description"]:
        rows = [[key.replace("_", " "), _text(value)] for key, value in d["description"].items()]
        parts += [element("h3", "Unknown input in numbers"), _table(["", ""], rows)]
    if curve := d.get("empirical"):
        rows = [[_number(x, ".4g"), _number(q, ".4g")] for x, q in curve["curve"]]
        offer = _note(f"Offered, not adopted: {curve['says']}. As a twin: empirical.toml.")
        parts += [element("h3", "Empirical curve"), offer, _table([curve["follows"], "W"], rows, 2)]
    if d["blind_spots"]:
        items = element("ul", *(element("li", text) for text in d["blind_spots"]))
        parts += [element("h3", "Blind spots of this record"), items]
    return joined(parts)


_SHOWN_KEYS = (
    "why",
    "steps",
    "possible",
    "name",
    "causes",
    "expected_difference",
    "needed_difference",
    "hottest_C",
    "hours",
)
"""Keys of a plan that its sentence and its table show already."""


def _experiment(d: dict[str, Any]) -> Html:
    """Render the next experiment, if the record leaves a question open."""
    plan = d["next_experiment"]
    if not plan:
        return NOTHING
    parts = [element("h2", "Next experiment")]
    parts += [element("p", str(plan["why"]))] if plan.get("why") else []
    steps = plan.get("steps") or ()
    columns = list(dict.fromkeys(column for step in steps for column in step if column != "time_s"))
    rows = [[_hours(step["time_s"]), *(_text(step.get(column, "")) for column in columns)] for step in steps[:-1]]
    rows += [[f"{_hours(step['time_s'])}: end", *[""] * len(columns)] for step in steps[-1:]]
    if rows:
        parts.append(_table(["from", *columns], rows, len(columns)))
        parts.append(_note("As a load profile: experiment.csv in this folder."))
    rest = [[k.replace("_", " "), _text(v)] for k, v in plan.items() if v and k not in _SHOWN_KEYS]
    return joined([*parts, *([_table(["", ""], rest)] if rest else [])])


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key.replace('_', ' ')} {_text(cell)}" for key, cell in value.items())
    if isinstance(value, list):
        return (", " if any(isinstance(cell, str) for cell in value) else " to ").join(_text(cell) for cell in value)
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _provenance(d: dict[str, Any]) -> Html:
    about = d.get("provenance") or {}
    rows = [[name, f"{item['path']}  sha256 {item['sha256'][:16]}"] for name, item in about.get("files", {}).items()]
    if d.get("revision"):
        rows.append(["revision of the twin", str(d["revision"])])
    rows += [[name, str(version)] for name, version in about.get("versions", {}).items()]
    rows += [[key, str(about[key])] for key in ("command", "made", "host") if about.get(key)]
    if d.get("seconds") is not None:
        rows.append(["took", f"{d['seconds']:.0f} s"])
    return joined([element("h3", "Provenance"), _table(["", ""], rows)]) if rows else NOTHING


def _sized(effect: dict[str, Any]) -> str:
    return _number(effect["value"]) + (f" {effect['unit']}" if effect["unit"] != "1" else "")


def _between(early: float, late: float) -> str:
    """Format an interval of times; a short one in seconds."""
    if late - early < 120.0:
        return f"± {0.5 * (late - early):.0f} s"
    return f"{_hours(early)} to {_hours(late)}"


def _number(value: float | None, form: str = ".3g") -> str:
    if value is None:
        return "–"
    return f"{value:.0f}" if form == ".3g" and 1000.0 <= abs(value) < 1e7 else format(value, form)


def _hours(seconds: float | None) -> str:
    if seconds is None:
        return "–"
    minutes = round(seconds / 60.0)
    return f"{minutes // 60} h {minutes % 60:02d} min"
