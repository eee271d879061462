"""JSON Schema of report.json; `python -m eval.report.schema.json_schema` writes schema.json."""

import json
from pathlib import Path

from eval.report.schema.report_data import Report

SCHEMA = Path(__file__).with_name("schema.json")


def schema() -> str:
    """Return the JSON Schema of `Report`, with meanings and units of the fields."""
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return json.dumps(dialect | Report.model_json_schema(), indent=1, ensure_ascii=False) + "\n"


if __name__ == "__main__":
    SCHEMA.write_text(schema(), encoding="utf-8")
