"""rorg completion"""

from __future__ import annotations

from typing import Annotated

from rorg.cli.options import Argument
from rorg.cli.output import echo

BASH = """
_rorg() {
    local IFS=$'\\n' found
    found=($(_RORG_COMPLETE=bash "$1" "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null))
    COMPREPLY=()
    case "${found[0]-}" in
        :files) compopt -o default ;;
        :directories) compopt -o dirnames ;;
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
        :directories) _files -/ ;;
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
        case '*'
            printf '%s\\n' $found
    end
end
complete --command rorg --no-files --arguments '(__rorg_complete)'
"""
SCRIPTS = {"bash": BASH, "zsh": ZSH, "fish": FISH}
"""Each passes the words of the line to rorg, the last one unfinished, and gets its completions (completions.py), one
per line; or :files or :directories, which the shell completes itself."""


def command(shell: Annotated[str, Argument("bash, zsh or fish.", choices=tuple(SCRIPTS))]) -> None:
    """Print the completion script of a shell.

    Example: source <(rorg completion bash)
    """
    echo(SCRIPTS[shell].strip())
