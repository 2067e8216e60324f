"""Public names of a package that are loaded on first use (PEP 562), so that importing a package costs nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping

Lookup = Callable[[str], object]
Listing = Callable[[], list[str]]


def lazy_names(package: str, modules: Mapping[str, tuple[str, ...]]) -> tuple[Lookup, Listing]:
    """Return ``__getattr__`` and ``__dir__`` of a package whose names come from its modules.

    Parameters
    ----------
    package
        Dotted name of the package, its ``__name__``.
    modules
        Module of the package -> public names that it defines. The empty key holds modules that are public themselves.
        ``"name = original"`` is a name that differs from the one in the module: a module of the package has that name.

    Returns
    -------
    tuple
        The two functions. ``__getattr__`` raises AttributeError for a name that is not public.
    """
    homes: dict[str, tuple[str, str]] = {}
    for module, names in modules.items():
        for entry in names:
            name, _, original = entry.partition(" = ")
            homes[name] = (module, original or name)

    def load(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no public name {name!r}")
        from importlib import import_module

        module, original = homes[name]
        if not module:
            return import_module(f"{package}.{name}")
        found: object = getattr(import_module(f"{package}.{module}"), original)
        return found  # not kept: a test may replace the name in its module

    def listed() -> list[str]:
        return sorted(homes)

    return load, listed
