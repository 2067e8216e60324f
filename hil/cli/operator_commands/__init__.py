"""Commands of operators beside a run: alarms and the browser panel."""
