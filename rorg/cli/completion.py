"""rorg completion, and the answers to the shells that use its scripts. typer finds what may follow on a line; names
come from names.py."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import typer

from rorg.cli.commands import ALIASES, COMMANDS
from rorg.cli.output import echo

BASH = """
_rorg() {
    local IFS=$'\\n' found
    found=($(_RORG_COMPLETE=bash "$1" "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null))
    COMPREPLY=()
    case "${found[0]-}" in
        :files) compopt -o default ;;
        :directories) compopt -o filenames -o plusdirs; COMPREPLY=("${found[@]:1}") ;;
        *) COMPREPLY=("${found[@]}") ;;
    esac
}
complete -F _rorg rorg
"""
ZSH = """
#compdef rorg
_rorg() {
    local -a found
    found=("${(@f)$(_RORG_COMPLETE=zsh rorg "${(@Q)words[2,CURRENT]}" 2>/dev/null)}")
    case "$found[1]" in
        :files) _files ;;
        :directories) shift found; (( $#found )) && _describe rorg found; _files -/ ;;
        ?*) _describe rorg found ;;
    esac
}
if [ "$funcstack[1]" = _rorg ]; then _rorg "$@"; else compdef _rorg rorg; fi
"""
FISH = """
function __rorg_complete
    set -l begun (string unescape -- (commandline -ct)) # it may begin with a quote
    set -l words (commandline -opc) "$begun" # an empty one is a word too
    set -l found (env _RORG_COMPLETE=fish rorg $words[2..-1] 2>/dev/null)
    switch "$found[1]"
        case ':files'
            __fish_complete_path (commandline -ct)
        case ':directories'
            __fish_complete_directories (commandline -ct)
            printf '%s\\n' $found[2..-1]
        case '*'
            printf '%s\\n' $found
    end
end
complete --command rorg --no-files --arguments '(__rorg_complete)'
"""
SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH}
"""Each passes the words of the line to rorg, the last one unfinished, and gets its completions, one per line; or :files
or :directories, which the shell completes itself. Words may follow :directories. typer's own scripts offer files where
no name fits, and that for fish starts rorg twice."""
PATHS = {"file": ":files", "dir": ":directories"}
BREAKS = ("=", ":")
"""Characters that are words of their own to bash."""


def command(shell: Annotated[Literal["bash", "zsh", "fish"], typer.Argument(help="bash, zsh or fish.")]) -> None:
    """Print the completion script of a shell.

    Example: source <(rorg completion bash)
    """
    echo(SCRIPTS[shell].strip())


def answer(shell: str, words: Sequence[str]) -> str:
    """The completions of the last word after `rorg`, in lines as the shell's script expects them."""
    from typer._completion_classes import BashComplete

    from rorg.cli.app import RORG

    typed = words[-1] if words else ""
    words = _joined(words) if shell == "bash" else list(words) or [""]
    begun = words[-1]
    if len(words) > 1 and words[0] not in (*COMMANDS, *ALIASES):
        return ""
    found = BashComplete(RORG, {}, "rorg", "_RORG_COMPLETE").get_completions(words[:-1], begun)
    prefix = begun[: begun.index("=") + 1] if begun.startswith("--") and "=" in begun else ""
    cut = len(begun.removesuffix(typed if typed not in BREAKS else "")) if shell == "bash" else 0
    lines = [PATHS.get(item.type) or _line(shell, (prefix + item.value)[cut:], item.help) for item in found]
    return "\n".join(line for line in lines if line.replace("\t", "").isprintable())


def _joined(words: Sequence[str]) -> list[str]:
    """The words as typed: bash splits --output=json into three words, and base:1.2 too."""
    whole_words: list[str] = []
    glue = False
    for word in words:
        sign = bool(whole_words) and (word == ":" or (word == "=" and whole_words[-1].startswith("--")))
        if sign or glue:
            whole_words[-1] += word
        else:
            whole_words.append(word)
        glue = sign
    return whole_words or [""]


def _line(shell: str, word: str, about: str | None) -> str:
    word = word.replace(":", "\\:") if shell == "zsh" else word
    if shell == "bash" or not about:
        return word
    return word + ("\t" if shell == "fish" else ":") + " ".join(about.split())
