"""Files with several documents, separated by lines `---`: each is read separately, and can be replaced alone."""

from __future__ import annotations

import re
from typing import Any

from rorg.manifest.yaml_source import MAX_NODES, Document, Reader, read_one
from rorg.model.diagnostics import Diagnostic, Where

_SEPARATOR = re.compile(r"^---(?=[ \t\r\n]|$)", re.M)
_CONTENT = re.compile(r"^(?!---[ \t\r]*(?:#|$))[ \t]*[^\s#%]|^[ \t]+%", re.M)


def document_texts(text: str) -> list[str]:
    """Splits a file at its lines `---`; together, the parts are the file. A part with nothing but comments and
    directives belongs to the document after it, or to the last one."""
    starts = [match.start() for match in _SEPARATOR.finditer(text)]
    parts = [text[a:b] for a, b in zip([0, *starts], [*starts, len(text)], strict=True)]
    texts, before = list[str](), ""
    for part in parts:
        before += part
        if _CONTENT.search(part):
            texts.append(before)
            before = ""
    if before and texts:
        texts[-1] += before
    return texts or [text]


def read_documents(
    text: str, file: str, most: int = MAX_NODES, items: int = MAX_NODES
) -> list[tuple[str, Document | None, list[Diagnostic]]]:
    """Reads all documents of a file: (the text, the document or None, what is wrong with it as YAML) of each. The
    limits are those of read_yaml(), and `items` also limits the number of documents; `most` is for all together."""
    texts = document_texts(text)
    if len(texts) > items:
        message = f"{len(texts)} documents, which is more than {items}"
        return [(text, None, [Diagnostic(Where(file), message, "fewer")])]
    documents = list[tuple[str, Document | None, list[Diagnostic]]]()
    line = count = 0
    for part in texts:
        reader = Reader(file, False, most, items, line, count)
        documents.append((part, read_one(reader, part), reader.diagnostics))
        line, count = line + part.count("\n"), reader.count
        if count > most:
            break
    return documents


def key_of(document: Document | None) -> tuple[str, str]:
    """(kind, name) that a document declares; empty if it has none."""
    value: Any = document.value if document else None
    metadata = value.get("metadata") if isinstance(value, dict) else None
    name = metadata.get("name") if isinstance(metadata, dict) else None
    kind = value.get("kind") if isinstance(value, dict) else None
    return (kind, name) if isinstance(kind, str) and isinstance(name, str) else ("", "")


def with_document(file: str, key: tuple[str, str], text: str | None) -> str | None:
    """The text of a file after `text` replaces the document of that kind and name (None: deletes it), while the other
    documents stay as they are; None if no document is left."""
    parts = []
    for part, document, _ in read_documents(file, ""):
        if key_of(document) != key:
            parts.append(part)
        elif text is not None:
            parts.append(text)
    for index in range(1, len(parts)):
        if not parts[index - 1].endswith("\n"):
            parts[index - 1] += "\n"
        if not _SEPARATOR.search(parts[index]):
            parts[index] = f"---\n{parts[index]}"
    return "".join(parts) if parts else None
