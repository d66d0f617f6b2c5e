"""What every piece of a description shares: a rule per field, errors with a place, repr and file form."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

from pydantic import BaseModel, ConfigDict, model_validator
from pydantic_core import core_schema

from urushi.errors import MaterialError, close

Data = Any
"""Plain data, as YAML and JSON know it: None, bool, int, float, str, list, dict with text keys."""


def shown(value: object) -> str:
    """The value found, short enough for one line of an error message."""
    if value is None:
        return "nothing"
    try:
        text = repr(value)
    except Exception:  # a foreign repr may fail in any way, and an error message must not
        text = f"a {type(value).__name__}"
    if len(text) > 60:
        text = text[:57] + "..."
    if isinstance(value, bool):
        return f"{text} (a truth value)"
    return f"{text} (text)" if isinstance(value, str) else text


def inside(error: MaterialError, place: str) -> MaterialError:
    """The same error, seen from one level further out: ``g`` inside ``phase`` is ``phase.g``."""
    inner = error.where or ""
    joint = "" if not inner or inner.startswith("[") else "."
    return MaterialError(error.problem, where=f"{place}{joint}{inner}", file=error.file)


class Rule:
    """What one field may hold: how it is read, said in words, shown, written and put into a schema."""

    meaning: str = ""

    def read(self, value: Any) -> Any:
        """The value in its stored form; raises `MaterialError` (its place relative to the field)."""
        raise NotImplementedError

    def allowed(self) -> str:
        """What is allowed, in words that complete 'allowed: ...'."""
        raise NotImplementedError

    def schema(self) -> dict[str, Any]:
        """JSON schema of the field's file form."""
        raise NotImplementedError

    def source(self, value: Any) -> str:
        """Python source of the value, for `repr`."""
        return repr(value)

    def data(self, value: Any, folder: Path | None) -> Data:
        """File form of the value; paths are written relative to ``folder`` (absolute if None)."""
        return value

    def refuse(self, value: object, why: str = "", where: str | None = None, near: str = "") -> MaterialError:
        """The error for a value that is not allowed; ``near`` is what `close` says of it."""
        reason = f", {why}" if why else ""
        return MaterialError(f"found {shown(value)}{reason}; {near}allowed: {self.allowed()}", where=where)

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        # `Description` applies the rule itself: it knows the name of the field, and so the place of an error.
        return core_schema.any_schema()


class Text(Rule):
    """Text of limited length, without lone surrogates (which no file can hold)."""

    def __init__(self, meaning: str, longest: int, lines: bool = False) -> None:
        self.meaning = meaning
        self.longest = longest
        self.lines = lines

    def read(self, value: Any) -> str:
        """The text itself."""
        if not isinstance(value, str):
            raise self.refuse(value, "put it in quotes" if isinstance(value, int | float) else "")
        if len(value) > self.longest:
            raise self.refuse(value, f"which has {len(value)} characters")
        if any("\ud800" <= letter <= "\udfff" for letter in value):
            raise self.refuse(value, "which holds half a character (a lone surrogate)")
        if not self.lines and len(value.splitlines()) > 1:
            raise self.refuse(value, "which has several lines")
        return str(value)

    def allowed(self) -> str:
        """In words."""
        return f"text of at most {self.longest} characters{'' if self.lines else ' on one line'}"

    def schema(self) -> dict[str, Any]:
        """A string."""
        return {"type": "string", "maxLength": self.longest}


class Choice(Rule):
    """One of a few given values."""

    def __init__(self, *choices: str | bool | None, meaning: str, hint: str = "") -> None:
        self.choices = choices
        self.meaning = meaning
        self.hint = hint

    def read(self, value: Any) -> str | bool | None:
        """The choice, which must match in type as well (1 is not true)."""
        for choice in self.choices:
            if isinstance(value, str if isinstance(choice, str) else type(choice)) and value == choice:
                return choice
        words = [choice for choice in self.choices if isinstance(choice, str)]
        near = close(value, words) if isinstance(value, str) else ""
        raise self.refuse(value, "" if near else self.hint, near=near)

    def allowed(self) -> str:
        """In words."""
        words = [repr(choice) for choice in self.choices if choice is not None]
        return " or ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)

    def schema(self) -> dict[str, Any]:
        """An enumeration."""
        return {"enum": [choice for choice in self.choices if choice is not None]}


class Description(BaseModel):
    """Base of every class that describes a piece of a material: frozen, compared by value, checked.

    Values may be given by position, in the order of the fields, or by name. Every refusal is a
    `MaterialError` that names the field, the value found and what is allowed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid", ignored_types=(Rule,))

    kind: ClassVar[str] = ""
    """Name in material files."""

    alternatives: ClassVar[tuple[tuple[str, ...], ...]] = ()
    """Sets of fields of which exactly one is given, for the schema; `check` enforces it."""

    def __init__(self, /, *args: Any, **values: Any) -> None:
        names = list(type(self).model_fields)
        if len(args) > len(names):
            raise MaterialError(
                f"found {len(args)} values; allowed: at most {len(names)}, in the order {', '.join(names)}"
            )
        for name, value in zip(names, args, strict=False):
            if name in values:
                raise MaterialError("given twice, by position and by name", where=name)
            values[name] = value
        super().__init__(**values)

    @classmethod
    def rules(cls) -> dict[str, Rule]:
        """The rule of every field, by name, in order."""
        return {
            name: next(item for item in field.metadata if isinstance(item, Rule))
            for name, field in cls.model_fields.items()
        }

    @model_validator(mode="before")
    @classmethod
    def _read(cls, values: Any) -> Any:
        """Read every value by its field's rule, then let the class check them together."""
        if not isinstance(values, Mapping):
            raise MaterialError(f"found {shown(values)}; allowed: a mapping of {', '.join(cls.model_fields)}")
        rules = cls.rules()
        for name in values:
            if name not in rules:
                keys = ", ".join(rules) or "none"
                raise MaterialError(
                    f"unknown key {shown(name)} in {cls.__name__}; {close(name, rules)}allowed: {keys}",
                    where=str(name)[:60],
                )
        read = {}
        for name, rule in rules.items():
            field = cls.model_fields[name]
            if name not in values:
                if field.is_required():
                    raise MaterialError(f"missing from {cls.__name__}; allowed: {rule.allowed()}", where=name)
                read[name] = field.default
            elif values[name] is None and field.default is None and not field.is_required():
                read[name] = None
            else:
                try:
                    read[name] = rule.read(values[name])
                except MaterialError as error:
                    raise inside(error, name) from None
        cls.check(read)
        return read

    @classmethod
    def check(cls, values: Mapping[str, Any]) -> None:
        """Check the values against one another (each one is already right by itself)."""

    def spoken(self) -> dict[str, Any]:
        """The values worth saying: the first field, and what differs from its default."""
        fields = type(self).model_fields
        first = next(iter(fields), None)
        values = {name: getattr(self, name) for name in fields}
        return {
            name: value
            for name, value in values.items()
            if value is not None and (name == first or value != fields[name].default)
        }

    def data(self, folder: Path | None = None) -> dict[str, Data]:
        """File form: plain data without defaults, texture paths relative to ``folder``."""
        rules = type(self).rules()
        return {name: rules[name].data(value, folder) for name, value in self.spoken().items()}

    def __repr__(self) -> str:
        rules = type(self).rules()
        parts = (f"{name}={rules[name].source(value)}" for name, value in self.spoken().items())
        return f"{type(self).__name__}({', '.join(parts)})"

    __str__ = __repr__

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Any:
        """A copy with some values replaced; unlike pydantic's own, it checks them."""
        values = {name: getattr(self, name) for name in type(self).model_fields}
        return type(self)(**{**values, **(update or {})})

    def __setattr__(self, name: str, value: object) -> None:
        raise MaterialError("a description is frozen: build a new one, or use Stack.replace", where=name)

    def __delattr__(self, name: str) -> None:
        raise MaterialError("a description is frozen: nothing can be deleted from it", where=name)


class Registered(Rule):
    """One of the classes of a registry, as an instance or in file form: ``name`` or ``{name: {...}}``."""

    def __init__(self, registry: Mapping[str, type[Description]], what: str, meaning: str) -> None:
        self.registry = registry
        self.what = what
        self.meaning = meaning

    def read(self, value: Any) -> Description:
        """The instance."""
        if isinstance(value, Description) and isinstance(value, tuple(self.registry.values())):
            return value
        if isinstance(value, str):
            value = {value: None}
        if not isinstance(value, Mapping):
            raise self.refuse(value)
        if len(value) != 1:
            keys = ", ".join(shown(key) for key in list(value)[:8]) or "none"
            raise MaterialError(f"found {len(value)} keys ({keys}); allowed: one key, {self.allowed()}")
        ((name, arguments),) = value.items()
        if name not in self.registry:
            problem = f"unknown {self.what} {shown(name)}; {close(name, self.registry)}"
            raise MaterialError(f"{problem}allowed: {self.allowed()}")
        arguments = {} if arguments is None else arguments
        if not isinstance(arguments, Mapping):
            fields = ", ".join(self.registry[name].model_fields) or "nothing"
            raise MaterialError(f"found {name} of {shown(arguments)}; allowed: a mapping of {fields}")
        return self.registry[name].model_validate(arguments)

    def allowed(self) -> str:
        """In words."""
        return f"a {self.what}, one of {', '.join(self.registry)}"

    def schema(self) -> dict[str, Any]:
        """Filled in by the `schema` module, which knows every class."""
        return {"$ref": f"#/$defs/{self.what.replace(' ', '_')}"}

    def data(self, value: Any, folder: Path | None) -> Data:
        """``name`` when there is nothing to say, else ``{name: {...}}``."""
        inner = value.data(folder)
        return {value.kind: inner} if inner else value.kind
