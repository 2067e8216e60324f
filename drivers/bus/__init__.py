"""Contract of every bus: values with quality and time of arrival."""
