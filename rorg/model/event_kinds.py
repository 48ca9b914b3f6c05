"""Kinds of events in the journal: stable words, which programs and `rorg events --kind` choose by."""

EVENT_KINDS = (
    *("container-unreadable", "crashed", "done", "down", "engine", "engine-lost", "failed", "found"),
    *("git", "git-commit", "git-refused", "git-submodules", "git-unreachable", "hold", "holds"),
    *("image-failed", "image-ready", "internal-error", "journal-damaged", "journal-not-written", "journal-written"),
    *("last-good-not-written", "last-words", "link-refused", "lost", "machine-not-written"),
    *("manifest", "manifest-error", "manifest-recovery", "manifest-warning", "no-socket"),
    *("notify-failed", "notify-recovered", "options-ignored", "parameters-set", "parameters-unwritten", "pause-risk"),
    *("plugged", "pressure", "reclaim-failed", "reclaimed", "recovered", "release", "removal"),
    *("request", "request-dropped", "requests-not-kept", "requests-not-written", "requests-refused"),
    *("restart", "retry", "revision-failed", "ros-node-taken-over", "ros-purged", "runs-twice", "shm-purged"),
    *("socket-restored", "stalled", "state", "superseded", "suspend", "suspended", "taken", "tls"),
    *("too-many-requests", "tree-accepted", "tree-refused", "unknown-service", "unplugged", "up", "update-failed"),
    *("violation", "withheld"),
)
