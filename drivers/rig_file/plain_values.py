"""Values of a rig file as a person writes them: numbers without quotes, hosts without port or scheme."""

from __future__ import annotations

import ipaddress
import re
from pathlib import Path
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError


def refuse_quoted_numbers(section: type[BaseModel], data: Any) -> None:
    """Raise ValidationError, with the key, for a number in quotes or true where a key of a section takes numbers alone.

    A discriminated union takes no validator for each field, so that all fields are checked together.
    """
    found: list[InitErrorDetails] = []
    for key, value in data.items() if isinstance(data, dict) else ():
        field = section.model_fields.get(key)
        what = None if field is None else _mistaken_number(value, field.annotation)
        if what is not None:
            # the words are a value of the message, since braces in them would be taken for keys
            error = PydanticCustomError("value_error", "{what}", {"what": what})
            found.append(InitErrorDetails(type=error, loc=(key,), input=value))
    if found:
        raise ValidationError.from_exception_data(section.__name__, found)


def _mistaken_number(value: Any, annotation: Any) -> str | None:
    """Return the mistake of a value of a key of type `annotation`, or None."""
    types = _types(annotation)
    if any(kind in types for kind in (str, Path, bool)) or not any(kind in types for kind in (int, float)):
        return None
    for item in value if isinstance(value, list | tuple) else [value]:
        if isinstance(item, bool):
            return f"must be a number, got {str(item).lower()}; correct it"
        if isinstance(item, str) and _is_number(item):
            return f"must be a number, got {item!r} in quotes; take the quotes out"
    return None


def checked_host(host: str) -> str:
    """Return the name or address of a host; raise ValueError with the remedy where it holds more than that."""
    if host != host.strip() or not host:
        raise ValueError(f"{host!r} has blanks or nothing in it; give the name or the address alone")
    if "/" in host:
        raise ValueError(f"{host!r} is a web address; give the name or the address alone, without http:// and path")
    with_port = re.fullmatch(r"([^:]+|\[.*\]):(\d*)", host)
    if with_port is not None:
        name, port = with_port[1].strip("[]"), with_port[2] or "502"
        raise ValueError(f'{host!r} holds a port; write host = "{name}" and port = {port}')
    short = re.fullmatch(r"(?:0|[1-9]\d*)(?:\.(?:0|[1-9]\d*)){0,2}", host)  # 127.1 is 127.0.0.1 to every resolver
    if ":" in host or (re.fullmatch(r"[\d.]+", host) and short is None):
        try:
            ipaddress.ip_address(host[1:-1] if host.startswith("[") and host.endswith("]") else host)
        except ValueError:
            raise ValueError(
                f"{host!r} is no address: IPv4 has four numbers from 0 to 255 without leading zeros; correct it"
            ) from None
    elif re.fullmatch(r"[\w.-]+", host) is None:
        raise ValueError(f"{host!r} is no name of a host; give the name or the address alone")
    return host


def _types(annotation: Any) -> list[Any]:
    """Return the plain types in an annotation."""
    inner = get_args(annotation)
    return [kind for part in inner for kind in _types(part)] if inner else [type(annotation), annotation]


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
