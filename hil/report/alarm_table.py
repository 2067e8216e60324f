"""Section of a report on the alarms of the run: each that came, its state at the end, and what operators did."""

from __future__ import annotations

from hil.alarms import AlarmError, AlarmEvent, AlarmWatch, condition_of, value_of
from hil.files import Html, element, joined, table
from hil.report.statistics import NONE, TimeUnit
from hil.run_folder import RunFolder

MOST_ROWS = 200
"""Acts that the section shows, the latest ones."""


def alarm_section(folder: RunFolder, unit: TimeUnit) -> Html:
    """Return the tables of alarms and of their transitions; none for a run that knows no alarms."""
    try:
        with AlarmWatch(folder.path) as watch:
            kept = watch.poll()
    except AlarmError as error:
        if not folder.alarms.exists():
            return joined([])  # a run of an earlier version
        return joined([element("h2", "Alarms"), element("p", str(error), class_="WARN")])
    heading = element("h2", "Alarms")
    came = [item for item in kept.statuses.values() if item.count or item.by]
    if not came:
        return joined([heading, element("p", "No alarm came.", class_="note")])
    came.sort(key=lambda item: (item.definition.rank, item.definition.id))
    rows = [
        [
            item.definition.id,
            item.definition.priority,
            str(item.count),
            unit.of(item.time_s if item.count else None),
            value_of(item.definition, item.value) or NONE,
            item.state.value,
            element("span", condition_of(item.definition, item.text)),
        ]
        for item in came
    ]
    head = ["alarm", "priority", "times", f"last / {unit.symbol}", "value", "state at the end", "condition"]
    body = [heading, table(head, rows, class_="prose")]
    acts = [record for record in kept.records if record.event not in (AlarmEvent.RAISE, AlarmEvent.CLEAR)]
    if acts:
        done = [
            [record.time, record.id, record.event.value, record.by, element("span", record.reason)]
            for record in acts[-MOST_ROWS:]
        ]
        body.append(element("p", "Acts of operators, the latest ones:", class_="note"))
        body.append(table(["time", "alarm", "act", "by", "reason"], done, class_="prose"))
    return joined(body)
