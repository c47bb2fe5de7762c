"""Former names of options and commands, translated to today's names before they are parsed.

They are accepted until the next release, and no help text shows them. Then this file is deleted.
"""

from __future__ import annotations

__all__ = ["CURRENT_OPTIONS", "RENAMED_OPTIONS", "translate"]

RENAMED_OPTIONS = {  # former name -> today's
    "--altered": "--allow-config-change",
    "--budget": "--train-spp",
    "--cap": "--radiance-cap",
    "--fresh": "--restart",
    "--half": "--bf16",
    "--norm": "--max-grad-norm",
    "--only": "--methods",
    "--picture": "--figure",
    "--retime": "--remeasure-sample-time",
    "--views": "--buffers",
}
CURRENT_OPTIONS = {
    ("stress", "--only"),
    ("run", "--retime"),
    ("new", "--scene"),
}  # a newer command may use a former name
FORMER_MODES = {  # command and option that selected a mode -> today's command, takes a file?
    ("render", "--scene"): ("render-scene", True),
    ("train", "--range-test"): ("lr-find", False),
    ("train", "--replay"): ("replay", True),
}


def translate(arguments: list[str]) -> tuple[list[str], list[str]]:
    """A command with its arguments in today's spelling, and a note for each former name.

    >>> translate(["train", "--range-test", "--half", "-m", "ours"])[0]
    ['lr-find', '--bf16', '-m', 'ours']
    >>> translate(["render", "--scene", "atrium.xml", "--frames", "20"])[0]
    ['render-scene', 'atrium.xml', '--frames', '20']
    """
    command, *rest = _split_values(arguments)
    notes = []
    for (former, option), (today, takes_file) in FORMER_MODES.items():
        if command == former and option in rest:
            index = rest.index(option)
            file = rest[index + 1 : index + 2] if takes_file else []
            rest = file + rest[:index] + rest[index + 1 + len(file) :]
            command = today
            notes.append(_note(f"{former} {option}", today))
    for index, word in enumerate(rest):
        if word in RENAMED_OPTIONS and (command, word) not in CURRENT_OPTIONS:
            rest[index] = RENAMED_OPTIONS[word]
            notes.append(_note(word, rest[index]))
            if word == "--budget" and rest[index + 1 : index + 2] == ["any"]:
                rest[index + 1] = "default"
    return [command, *rest], notes


def _split_values(arguments: list[str]) -> list[str]:
    """The arguments with `--former=value` as two words, so that former names stand alone."""
    former = {*RENAMED_OPTIONS, *(option for _, option in FORMER_MODES)}
    words = []
    for argument in arguments:
        option, equals, value = argument.partition("=")
        words += [option, value] if equals and option in former else [argument]
    return words


def _note(former: str, today: str) -> str:
    return f"note: '{former}' is now '{today}'; the former name works until the next release"
