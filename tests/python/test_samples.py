"""The golden samples of the bus against both descriptions of their forms: the document for programs, and `shapes.py`. Judge: jsonschema-rs."""

import json

import jsonschema_rs
import shapes
from shared import PROJECT

GOLDEN = PROJECT / "common" / "contract" / "golden" / "v1"
ASYNCAPI = PROJECT / "docs" / "api" / "asyncapi.json"


def test_the_golden_samples_have_their_shapes_and_every_breakage_is_noticed(capsys):
    assert shapes.self_check() == 0, capsys.readouterr().out


def test_every_sample_of_the_bus_has_the_form_that_the_document_promises():
    document = json.loads(ASYNCAPI.read_text())
    judged = 0
    for name, message in document["components"]["messages"].items():
        schema = {**message["payload"], "components": document["components"]}
        validator = jsonschema_rs.Draft202012Validator(schema)
        samples = json.loads((GOLDEN / f"{name}.json").read_text())
        for sample in samples if isinstance(samples, list) else [samples]:
            errors = [error.message for error in validator.iter_errors(sample)]
            assert not errors, f"{name}: {errors[:3]}"
            judged += 1
    assert judged > 60, judged
