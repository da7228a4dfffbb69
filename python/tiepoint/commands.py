"""The commands of the program as functions. They are made from the program's own description of its
commands and options, so that both always agree."""

import inspect
import json
import os

from . import _tiepoint
from .progress import default_progress

# Commands whose name says too little, or is that of another function.
NAMES = {
    "features": "extract_features",
    "match": "match_images",
    "map": "map_images",
    "undistort": "undistort_images",
}


def keyword(name):
    """The keyword of an option: `max_size` of `max-size`."""
    return name.replace("-", "_")


def text(value):
    """A value as the program reads it; the items of a list are separated by commas."""
    if hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return ",".join(map(text, value))
    return os.fspath(value) if hasattr(value, "__fspath__") else str(value)


def several(value):
    """The values of an argument that may be given more than once."""
    return list(value) if isinstance(value, (list, tuple)) else [value]


def arguments_of(command, values):
    """The arguments of the program. `values`: by keywords."""
    options, positional = [], []
    for argument in command["arguments"]:
        value = values.get(keyword(argument["name"]))
        if value is None or value is False:
            continue
        if argument["is_positional"]:
            positional += [text(item) for item in several(value)]
        elif argument["is_flag"]:
            if value is not True:
                raise _tiepoint.UsageError(f"{keyword(argument['name'])} is True or False")
            options.append(f"--{argument['name']}")
        else:
            items = several(value) if argument["is_repeated"] else [value]
            options += [f"--{argument['name']}={text(item)}" for item in items]
    return options, positional


def signature_of(command):
    """The positional arguments of the program, then the options without which it fails, then the
    other options as keywords. Behind an argument that may be left out, all may be."""
    kind, parameters = inspect.Parameter, []
    first = [a for a in command["arguments"] if a["is_positional"]]
    first += [a for a in command["arguments"] if a["is_required"] and not a["is_positional"]]
    default = kind.empty
    for argument in first:
        if not argument["is_required"]:
            default = None
        name = keyword(argument["name"])
        parameters.append(kind(name, kind.POSITIONAL_OR_KEYWORD, default=default))
    for argument in command["arguments"]:
        if argument not in first:
            default = False if argument["is_flag"] else None
            parameters.append(kind(keyword(argument["name"]), kind.KEYWORD_ONLY, default=default))
    for name in ("threads", "progress"):
        parameters.append(kind(name, kind.KEYWORD_ONLY, default=None))
    return inspect.Signature(parameters, return_annotation=dict)


def docstring_of(command):
    lines = [command["help"], "", f"As `tiepoint {' '.join(command['words'])}`.", ""]
    for argument in command["arguments"]:
        default = f" [default: {argument['default']}]" if argument["default"] else ""
        choices = f" [{', '.join(argument['values'])}]" if argument["values"] else ""
        lines.append(f"{keyword(argument['name'])}: {argument['help']}{choices}{default}")
    lines.append("threads: Number of threads; by default all of the machine.")
    lines.append(
        "progress: A function that gets each event as a dictionary; True for a bar, False for none."
        " By default a bar in terminals and notebooks. An exception stops the work, which a further"
        " call resumes."
    )
    lines.append("")
    lines.append("Returns the result as a dictionary; raises `Error` if the work fails, and")
    lines.append("`UsageError` if an argument is invalid.")
    return "\n".join(lines)


def function_of(command):
    signature = signature_of(command)

    def call(*args, **kwargs):
        try:
            bound = signature.bind(*args, **kwargs).arguments
        except TypeError as error:
            raise TypeError(f"{call.__name__}() {error}") from None
        return run(command, bound)

    call.__name__ = call.__qualname__ = name_of(command)
    call.__doc__ = docstring_of(command)
    call.__signature__ = signature
    call.__module__ = "tiepoint"
    return call


def run(command, values):
    threads, progress = values.get("threads"), values.get("progress")
    options, positional = arguments_of(command, values)
    if threads is not None:
        options.append(f"--threads={threads}")
    with default_progress(progress) as on_event:
        result = _tiepoint.run([*command["words"], *options, "--", *positional], on_event)
    return None if result is None else json.loads(result)


def name_of(command):
    name = "_".join(keyword(word) for word in command["words"])
    return NAMES.get(name, name)


def commands():
    """The names of the functions that are commands of the program."""
    return list(FUNCTIONS)


FUNCTIONS = {name_of(command): function_of(command) for command in json.loads(_tiepoint.commands())}
