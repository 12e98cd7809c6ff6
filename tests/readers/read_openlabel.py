"""Check a document by the schema of ASAM OpenLABEL 1.0.0 that Vicomtech's library has."""

import json
import sys
from pathlib import Path

import jsonschema
from vcd.schema import openlabel_schema

document = json.loads(Path(sys.argv[1]).read_text())
checker = jsonschema.validators.validator_for(openlabel_schema)(openlabel_schema)
errors = [f"{each.json_path}: {each.message}" for each in checker.iter_errors(document)]
json.dump({"schema": openlabel_schema["$id"], "errors": errors}, sys.stdout)
