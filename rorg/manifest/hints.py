"""The places of the keys of Compose, Kubernetes, systemd and roslaunch: the remedy for an unknown key of a manifest.

A word that rorg knows exactly comes before a name that only looks similar, and no remedy names a key that the mapping
at its path lacks.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from types import MappingProxyType

from pydantic import BaseModel

from rorg.manifest.container import ContainerOptions
from rorg.manifest.fields import model_of
from rorg.manifest.models import ENVELOPES, SPECS
from rorg.model.diagnostics import nearest

_C = "spec.container."
_COMPOSE = {
    "depends_on": "spec.needs",
    "env": f"{_C}environment",
    "profiles": "a manifest of kind Group",
    "build": "a manifest of kind Image",
    "deploy": "spec.resources, and cpus and mem_limit in spec.container",
    "scale": "one Service for each copy",
    "secrets": f"{_C}volumes",
    "configs": "spec.mounts",
    "extends": "spec.profile",
    "external_links": f"{_C}network_mode: host",
    "links_external": f"{_C}network_mode: host",
    "pull_policy": "`rorg build`, which pulls what is missing",
    "credential_spec": "to leave it out: it is for Windows",
    "auto_remove": "spec.idle: {action: remove}",
    "nano_cpus": f"{_C}cpus",
    "memory": "spec.resources.memory",
    "cpu": "spec.resources.cpu",
    "mem": f"{_C}mem_limit",
    "network": f"{_C}networks",
    "services": "`rorg import compose FILE` for a Compose project",
    "develop": "`rorg dev`",
    "container": "spec.container",
    "name": "metadata.name",
    "description": "metadata.description",
    "tags": "metadata.name",
}
_KUBERNETES = {
    "args": "spec.command",
    "env_from": f"{_C}env_file: [./FILE.env]",
    "liveness_probe": "spec.live: {http: http://localhost:8080/health}",
    "readiness_probe": "spec.ready: {http: http://localhost:8080/health}",
    "startup_probe": "spec.ready: {http: http://localhost:8080/health, timeout: 1m}",
    "volume_mounts": f"{_C}volumes",
    "working_dir": f"{_C}working_dir",
    "replicas": "one Service for each copy",
    "containers": "one Service for each container",
    "template": "one Service for each container",
    "init_containers": "a Service with ready: {completed: true}, and its name in needs",
    "restart_policy": "spec.restart: on-failure",
    "host_network": f"{_C}network_mode: host",
    "host_pid": f"{_C}pid: host",
    "host_ipc": f"{_C}ipc: host",
    "host_aliases": f"{_C}extra_hosts",
    "runtime_class_name": f"{_C}runtime",
    "image_pull_policy": "`rorg build`, which pulls what is missing",
    "security_context": "user, privileged, cap_add and security_opt in spec.container",
    "run_as_user": f"{_C}user",
    "allow_privilege_escalation": f"{_C}security_opt: [no-new-privileges:true]",
    "read_only_root_filesystem": f"{_C}read_only",
    "termination_grace_period_seconds": f"{_C}stop_grace_period",
    "priority_class_name": "spec.priority: 80",
    "selector": "to leave it out: needs names services",
    "namespace": "to leave it out: a robot has one namespace",
    "limits": "cpus and mem_limit in spec.container",
    "requests": "spec.resources: {cpu: 0.5, memory: 256Mi}",
}
_SYSTEMD = {
    "exec_start": "spec.command",
    "exec_start_pre": "a Service with ready: {completed: true}, and its name in needs",
    "exec_reload": "spec.on_change: signal SIGHUP",
    "exec_stop": f"{_C}stop_signal: SIGINT",
    "working_directory": f"{_C}working_dir",
    "cwd": f"{_C}working_dir",
    "after": "spec.needs",
    "requires": "spec.needs",
    "wants": "spec.needs",
    "requisite": "spec.needs",
    "dependencies": "spec.needs",
    "depends": "spec.needs",
    "binds_to": "spec.needs: [{service: roscore, restart: true}]",
    "part_of": "spec.needs: [{service: roscore, restart: true}]",
    "before": "needs in the other service",
    "required_by": "needs in the other service",
    "wanted_by": "spec.always_on: true",
    "enabled": "spec.always_on",
    "autostart": "spec.always_on",
    "environment_file": f"{_C}env_file",
    "restart_sec": "to leave it out: the delay before a restart grows by itself",
    "memory_max": f"{_C}mem_limit",
    "memory_limit": f"{_C}mem_limit",
    "memory_high": f"{_C}mem_reservation",
    "cpu_quota": f"{_C}cpus: 0.5",
    "cpu_weight": f"{_C}cpu_shares: 512",
    "cpu_affinity": f"{_C}cpuset",
    "oom_score_adjust": f"{_C}oom_score_adj",
    "limit_nofile": f"{_C}ulimits: {{nofile: 4096}}",
    "timeout_stop_sec": f"{_C}stop_grace_period",
    "timeout_start_sec": "spec.ready: {delay: 3s, timeout: 1m}",
    "watchdog_sec": "spec.live: {file: /tmp/alive, interval: 10s}",
    "kill_signal": f"{_C}stop_signal",
    "standard_output": f"{_C}logging: {{driver: journald}}",
    "ambient_capabilities": f"{_C}cap_add",
    "respawn": "spec.restart: always",
    "cmd": "spec.command",
    "hardware": "spec.driver",
}
WORDS: Mapping[str, str] = MappingProxyType({**_COMPOSE, **_KUBERNETES, **_SYSTEMD})
"""Word of another tool -> the path of a key, which an example value may follow; or an instruction."""
_PROBE = {
    "http_get": "http: http://localhost:8080/health",
    "url": "http",
    "tcp_socket": "tcp: 8080",
    "port": "tcp",
    "command": "exec",
    "cmd": "exec",
    "test": "exec",
    "initial_delay_seconds": "delay",
    "period_seconds": "interval",
    "period": "interval",
    "timeout_seconds": "timeout",
    "start_period": "timeout",
    "failure_threshold": "failures",
    "retries": "failures",
}
HERE: Mapping[str, Mapping[str, str]] = MappingProxyType(
    {
        **dict.fromkeys(("Ready", "Live", "ServiceProbe", "Interlock"), _PROBE),
        "Need": {
            "name": "service",
            "condition": "to leave it out: rorg waits until a needed service is ready",
            "required": "to leave it out: rorg waits until a needed service is ready",
        },
        "Idle": {"timeout": "linger", "after": "linger", "delay": "linger"},
        "ImageSpec": {"build_args": "args", "file": "dockerfile", "path": "context", "build": "context"},
        "Metadata": {"annotations": "labels"},
        "ContainerOptions": {"memory": "mem_limit", "cpu": "cpus"},
    }
)
"""Model of a mapping -> words that mean one of its own keys, or an instruction."""
KINDS: Mapping[str, str] = MappingProxyType(
    {
        **dict.fromkeys(("Deployment", "Pod", "StatefulSet", "DaemonSet", "ReplicaSet", "Job"), "'Service'"),
        "PersistentVolume": "'Volume'",
        "PersistentVolumeClaim": "'Volume'",
        "ConfigMap": "spec.mounts of the services that read it",
        "Secret": "container.env_file of the services that read it",
    }
)
"""Kind of Kubernetes -> remedy."""


def plain(word: str) -> str:
    """The word without case, hyphens and underscores: workingDir, working-dir and working_dir are one word."""
    return word[:100].replace("_", "").replace("-", "").lower()


_WORDS = {plain(word): remedy for word, remedy in WORDS.items()}
_HERE = {name: {plain(word): remedy for word, remedy in words.items()} for name, words in HERE.items()}


CLOSE = 0.66
"""Least similarity of a misspelt key, from 0 to 1."""


def remedy_for(
    kind: str, path: tuple[str, ...], key: str, parent: type[BaseModel] | None, present: Collection[str] = ()
) -> str:
    """The remedy for an unknown `key` in the mapping at `path`, whose model is `parent` and which has the keys
    `present`; empty if none is certain or close."""
    word, own = plain(key), names_of(parent)
    here = _HERE.get(parent.__name__, {}).get(word, "") if parent else ""
    if same := next((name for name in own if name == here or plain(name) == word), ""):
        return f"'{same}'"
    if here and (here.startswith("to ") or here.partition(":")[0] in own):
        return here
    if not here and (remedy := _elsewhere(kind, path, word)):
        return remedy
    return nearest(key, [name for name in own if name not in present], CLOSE)


def _elsewhere(kind: str, path: tuple[str, ...], word: str) -> str:
    """The place of a word that another tool uses here, or of a key of rorg that belongs to another mapping."""
    words = [_WORDS[word]] if word in _WORDS and kind in ("Service", "Profile", "") else []
    for remedy in (*words, *_at_other_depth(kind, word)):
        place = remedy.partition(":")[0]
        if not place.startswith(("spec.", "metadata.")) or " " in place:
            return remedy
        if _exists(kind, place):
            return _relative(path, remedy)
    return ""


def _at_other_depth(kind: str, word: str) -> list[str]:
    spec = SPECS.get(kind)
    options = [f"{_C}{name}" for name in names_of(ContainerOptions) if plain(name) == word]
    fields = [f"spec.{name}" for name in names_of(spec) if plain(name) == word]
    metadata = [f"metadata.{word}"] if word in ("name", "labels", "description") else []
    return [*fields, *metadata, *options]


def _relative(path: tuple[str, ...], remedy: str) -> str:
    """The remedy as a key of the mapping itself, if it is one."""
    place, colon, example = remedy.partition(":")
    above, _, name = place.rpartition(".")
    if tuple(above.split(".")) != path:
        return remedy
    return f"{name}:{example}" if colon else f"'{name}'"


def _exists(kind: str, place: str) -> bool:
    first, *rest = place.split(".")
    model: type[BaseModel] | None = SPECS.get(kind)
    if first == "metadata":
        model = model_of(ENVELOPES.get(kind, ENVELOPES["Service"]).model_fields["metadata"].annotation)
    for name in rest:
        field = model.model_fields.get(name) if model else None
        if field is None:
            return False
        model = model_of(field.annotation)
    return True


def names_of(model: type[BaseModel] | None) -> list[str]:
    """The keys of a mapping, as people write them."""
    return [field.alias or name for name, field in model.model_fields.items()] if model else []
