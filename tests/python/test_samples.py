"""The golden samples of the bus against both descriptions of their forms: the document for programs, and `shapes.py`. Judge: jsonschema-rs."""

import json

import jsonschema_rs
import shapes
from shared import PROJECT

GOLDEN = PROJECT / "common" / "contract" / "golden" / "v1"
ASYNCAPI = PROJECT / "docs" / "api" / "asyncapi.json"
# when it was sent and whether it was held back, which each program has
ENVELOPE = {"held_s", "sent_s"}


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


def test_every_field_that_an_observatory_node_may_publish_is_in_a_sample():
    document = json.loads(ASYNCAPI.read_text())
    published = [name for name in document["components"]["messages"] if name.startswith("observatory.")]
    assert len(published) > 10, published
    missing = set()
    for name in published:
        samples = json.loads((GOLDEN / f"{name}.json").read_text())
        missing |= without_sample(document, document["components"]["messages"][name]["payload"], samples if isinstance(samples, list) else [samples], name)
    assert missing - {f"{name}.{field}" for name in published for field in ENVELOPE} == set()


def without_sample(document: dict, schema: object, values: list, place: str) -> set[str]:
    """The fields of a schema that none of the values at its place has."""
    schema = resolved(document, schema)
    if not values or not isinstance(schema, dict):
        return set()
    missing: set[str] = set()
    for one in (one for key in ("anyOf", "oneOf", "allOf") for one in schema.get(key, [])):
        missing |= without_sample(document, one, [value for value in values if is_variant(document, one, value)], place)
    objects = [value for value in values if isinstance(value, dict)]
    fields = schema.get("properties", {})
    for name, field in fields.items():
        inner = [value[name] for value in objects if name in value]
        missing |= without_sample(document, field, inner, f"{place}.{name}") if inner or not objects else {f"{place}.{name}"}
    free = [value for one in objects for name, value in one.items() if name not in fields]
    missing |= without_sample(document, schema.get("additionalProperties"), free, f"{place}.*")
    elements = [element for value in values if isinstance(value, list) for element in value]
    return missing | without_sample(document, schema.get("items"), elements, f"{place}[]")


def resolved(document: dict, schema: object) -> object:
    while isinstance(schema, dict) and "$ref" in schema:
        at: object = document
        for part in schema["$ref"].removeprefix("#/").split("/"):
            at = at[part]
        schema = at
    return schema


def is_variant(document: dict, schema: object, value: object) -> bool:
    """Has the value the words by which a variant of an enumeration is known?"""
    fields = (resolved(document, schema) or {}).get("properties", {})
    known = {name: found["const"] for name, found in ((name, resolved(document, field)) for name, field in fields.items()) if "const" in found}
    return not known or isinstance(value, dict) and all(value.get(name) == word for name, word in known.items())
