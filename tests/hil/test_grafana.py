"""Dashboards for Grafana: what Grafana asks of a dashboard's JSON, checked without Grafana.

The queries run on PostgreSQL in `test_stream_postgres.py`. Model:
https://grafana.com/docs/grafana/latest/dashboards/build-dashboards/view-dashboard-json-model/
"""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path
from typing import Any

import pytest

from tests.docs.fences import PROJECT

DASHBOARDS = sorted((PROJECT / "profiles" / "grafana").glob("*.json"))
CORE_PANELS = {"stat", "table", "timeseries", "text", "gauge", "barchart", "histogram", "state-timeline"}
MACROS = {"__timeFilter", "__timeGroup", "__timeGroupAlias", "__interval", "__timeFrom", "__timeTo"}
SCHEMAS = range(36, 43)
"""Versions of the schema in which a data source is an object with type and uid, up to that of Grafana 12."""
COLUMNS = 24


@pytest.fixture(params=DASHBOARDS, ids=lambda path: path.stem)
def dashboard(request: pytest.FixtureRequest) -> dict[str, Any]:
    path: Path = request.param
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def variables(dashboard: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["name"]: one for one in dashboard["templating"]["list"]}


def test_each_query_goes_to_the_variable_for_the_data_source(dashboard: dict[str, Any]) -> None:
    sources = {name: one["query"] for name, one in variables(dashboard).items() if one["type"] == "datasource"}
    asked = [panel["datasource"] for panel in dashboard["panels"]]
    asked += [target["datasource"] for panel in dashboard["panels"] for target in panel["targets"]]
    asked += [one["datasource"] for one in variables(dashboard).values() if one["type"] == "query"]
    assert {(one["uid"], one["type"]) for one in asked} == {(f"${{{name}}}", kind) for name, kind in sources.items()}


def test_a_query_names_variables_that_are_there_and_macros_of_grafana(dashboard: dict[str, Any]) -> None:
    known = variables(dashboard)
    texts = [(target["rawSql"], set(known)) for panel in dashboard["panels"] for target in panel["targets"]]
    before: set[str] = set()
    for name, one in known.items():  # a variable may ask for those before it
        if one["type"] == "query":
            texts.append((one["query"], set(before)))
        before.add(name)
    used: set[str] = set()
    for text, allowed in texts:
        found = set(re.findall(r"\$\{(\w+)(?::sqlstring)?\}", text))
        assert found <= allowed, text
        assert set(re.findall(r"\$(\w+)", text)) <= MACROS, text
        used |= found
        lists = set(re.findall(r"IN \(\$\{(\w+):sqlstring\}\)", text))
        assert {name for name in found if known[name].get("multi")} == lists, text
    assert used == {name for name, one in known.items() if one["type"] == "query"}


def test_panels_are_of_grafana_itself_with_a_place_of_their_own(dashboard: dict[str, Any]) -> None:
    assert dashboard["schemaVersion"] in SCHEMAS and dashboard["title"] and dashboard["uid"]
    panels = dashboard["panels"]
    assert {panel["type"] for panel in panels} <= CORE_PANELS
    assert len({panel["id"] for panel in panels}) == len(panels) and all(panel["title"] for panel in panels)
    for panel in panels:
        place = panel["gridPos"]
        assert place["x"] >= 0 and place["x"] + place["w"] <= COLUMNS and min(place["w"], place["h"]) > 0
        references = [target["refId"] for target in panel["targets"]]
        assert len(set(references)) == len(references) > 0
        wanted = "time_series" if panel["type"] == "timeseries" else "table"
        assert {target["format"] for target in panel["targets"]} == {wanted}
        assert all(target["rawQuery"] for target in panel["targets"])
    for one, other in itertools.combinations([panel["gridPos"] for panel in panels], 2):
        apart = [a[k] + a[s] <= b[k] for k, s in (("x", "w"), ("y", "h")) for a, b in ((one, other), (other, one))]
        assert any(apart), (one, other)
