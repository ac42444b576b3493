"""Reference and JSON schema of scenario files and plugin parameters, generated from the models."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from pydantic.json_schema import models_json_schema

from optdock.config.plugin_sections import PLUGIN_DEFAULTS, plural
from optdock.config.scenario_keys import SECTIONS, ScenarioDocument
from optdock.errors import PluginError
from optdock.plugins.registry import INTERFACES, available_plugins, load_plugin

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pydantic import BaseModel

__all__ = ["KeyReference", "plugin_reference", "scenario_reference", "scenario_schema"]

Schema: TypeAlias = "dict[str, Any]"  # JSON

_DIALECT = "https://json-schema.org/draft/2020-12/schema"
_REFS = "#/$defs/{model}"
_UNIT = re.compile(r" ?\[((?:m|s|rad|1|Hz)(?:[,/^ ].*?)?)\]")
_TYPES = {
    "number": "number",
    "integer": "whole number",
    "boolean": "true or false",
    "string": "text",
    "array": "list",
    "object": "mapping",
}
_BOUNDS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


class KeyReference(NamedTuple):
    """Description of one key of a scenario file or of one plugin parameter.

    Attributes:
        key: Dotted name.
        type: Notation of the value.
        unit: SI unit, or empty.
        rule: Allowed values.
        default: Default in YAML; empty if there is none.
        required: Whether the key must be given.
        absent: Meaning of a missing key.
        description: Description.
    """

    key: str
    type: str
    unit: str
    rule: str
    default: str
    required: bool
    absent: str
    description: str


def scenario_reference() -> tuple[KeyReference, ...]:
    """Return every key of a scenario file in the order of the format; for plugin parameters see `plugin_reference`."""
    return _reference(ScenarioDocument)


def plugin_reference(kind: str, name: str) -> tuple[KeyReference, ...]:
    """Return every parameter of a plugin.

    Args:
        kind: One of `optdock.plugins.registry.INTERFACES`, such as `smoothers`.
        name: Name of the plugin.

    Raises:
        PluginError: If the kind or plugin does not exist or cannot be imported.

    >>> [row.key for row in plugin_reference("timing", "NearOptimal")]
    ['step', 'smooth']
    """
    if kind not in INTERFACES:
        raise PluginError(f"plugin kind {kind!r}: must be one of {', '.join(INTERFACES)}")
    return _reference(load_plugin(INTERFACES[kind], name).Parameters)


def scenario_schema() -> Schema:
    """Return a JSON schema (draft 2020-12) of scenario files with the parameters of every installed plugin.

    Additional keywords: `x-unit`; `x-finite` if infinity is rejected; `x-absent`, the meaning of a missing key;
    `x-form`, the notation of a value. Rules on several keys (such as `at_dock <= required`) and on geometry are only
    checked by `load_scenario`.
    """
    plugins = {section: _parameter_models(section) for section in SECTIONS}
    models: list[type[BaseModel]] = [ScenarioDocument, *(m for found in plugins.values() for m in found.values())]
    refs, whole = models_json_schema([(model, "validation") for model in dict.fromkeys(models)], ref_template=_REFS)
    definitions: dict[str, Schema] = whole["$defs"]
    schema = definitions.pop(_name_of(refs[ScenarioDocument, "validation"]))
    for section, found in plugins.items():
        parameters = {name: definitions[_name_of(refs[model, "validation"])] for name, model in found.items()}
        schema["properties"][section].update(_section(parameters, PLUGIN_DEFAULTS[section]))
    head = {"$schema": _DIALECT, "title": "optdock scenario, format optdock-scenario/1"}
    return {**_for_editors(schema), **head, "$defs": _for_editors(definitions)}


def _parameter_models(section: str) -> dict[str, type[BaseModel]]:
    """Return the parameter models of a section's installed plugins, except plugins that cannot be imported."""
    kind = plural(section)
    found: dict[str, type[BaseModel]] = {}
    for plugin in available_plugins():
        if plugin.kind == kind:
            with suppress(PluginError):
                found[plugin.name] = load_plugin(INTERFACES[kind], plugin.name).Parameters
    return found


def _section(parameters: Mapping[str, Schema], default: str) -> Schema:
    """Return the schema of a section with the parameters of the named or default plugin."""
    names = [{"enum": list(parameters)}, {"type": "string", "pattern": "::|/"}]  # or a class name of Nav2
    cases = [
        {
            "if": {"properties": {"plugin": {"const": name}}, "required": [] if name == default else ["plugin"]},
            "then": {"properties": {"plugin": {}, **model["properties"]}, "additionalProperties": False},
        }
        for name, model in parameters.items()
    ]
    return {"properties": {"plugin": {"anyOf": names, "default": default}}, "allOf": cases}


def _name_of(reference: Mapping[str, Any]) -> str:
    return str(reference["$ref"]).rsplit("/", 1)[1]


def _for_editors(value: Any) -> Any:  # noqa: ANN401 - JSON
    """Add units as keywords; remove generated titles, defaults that are not JSON, and defaults of whole mappings."""
    if isinstance(value, list):
        return [_for_editors(item) for item in value]
    if not isinstance(value, dict):
        return value
    kept = {key: item for key, item in value.items() if _is_kept(key, item)}
    unit = _UNIT.search(kept["description"]) if isinstance(kept.get("description"), str) else None
    return {key: _for_editors(item) for key, item in kept.items()} | ({"x-unit": unit[1]} if unit else {})


def _is_kept(key: str, value: object) -> bool:
    if key == "title":
        return not isinstance(value, str)  # the key `title` of an object
    return key != "default" or not (isinstance(value, dict) or (isinstance(value, float) and math.isinf(value)))


def _reference(model: type[BaseModel]) -> tuple[KeyReference, ...]:
    schema = model.model_json_schema(ref_template=_REFS)
    return tuple(_rows(schema, schema.get("$defs", {}), ""))


def _rows(schema: Schema, definitions: Mapping[str, Schema], base: str) -> Iterator[KeyReference]:
    for name, own in schema.get("properties", {}).items():
        parts = list(_alternatives(own, definitions))
        required = name in schema.get("required", ())
        default = "" if required else _as_yaml(own.get("default"))
        description, unit = str(own.get("description", "")), ""
        found = _UNIT.search(description)
        if found:
            unit, description = found[1], (description[: found.start()] + description[found.end() :]).strip(" ;")
        yield KeyReference(
            key=base + name,
            type=" or ".join(dict.fromkeys(filter(None, map(_type, parts)))),
            unit=unit,
            rule=_rule([own, *parts]),
            default=default,
            required=required,
            absent="" if required else own.get("x-absent", default),
            description=description,
        )
        for part in parts:
            yield from _rows(part, definitions, f"{base}{name}.")


def _alternatives(schema: Schema, definitions: Mapping[str, Schema]) -> Iterator[Schema]:
    """Generate the alternatives of a schema except null, with references resolved."""
    if "$ref" in schema:
        yield from _alternatives(definitions[_name_of(schema)], definitions)
    elif "anyOf" in schema and "x-form" not in schema:
        for part in schema["anyOf"]:
            yield from _alternatives(part, definitions)
    elif schema.get("type") != "null":
        yield schema


def _type(schema: Schema) -> str:
    if "x-form" in schema:
        return str(schema["x-form"])
    if "const" in schema:
        return str(schema["const"])
    if "enum" in schema:
        return f"one of {', '.join(map(str, schema['enum']))}"
    if "items" in schema:
        return f"list of {_type(schema['items'])}"
    return _TYPES.get(schema.get("type", ""), "")


def _rule(parts: list[Schema]) -> str:
    bounds = [f"{sign} {part[name]:g}" for part in parts for name, sign in _BOUNDS.items() if name in part]
    finite = ["finite"] if any(part.get("x-finite") for part in parts) else []
    return " and ".join(dict.fromkeys(finite + bounds))


def _as_yaml(default: object) -> str:
    if isinstance(default, bool):
        return str(default).lower()
    if isinstance(default, float):
        return ".inf" if math.isinf(default) else f"{default:g}"
    return "" if default is None or isinstance(default, dict) else str(default)
