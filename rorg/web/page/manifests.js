// The manifests: read, change with the mistakes of the whole tree at once, and commit. A text that is being edited
// belongs to the version that was loaded: nobody else's commit is overwritten, and no typed text is lost.

import { html, useEffect, useRef, useState } from "/page/vendor/preact.js";
import { call, encode, state, useStore } from "/page/store.js";

const PAUSE = 500;
const AGAIN = 5000;

/** Manifests with uncommitted text -> what Editor knows of it. They outlive the view, and other manifests. */
const drafts = new Map();

const keyOf = ({ kind, name }) => `${kind}/${name}`;

addEventListener("beforeunload", (event) => drafts.size && event.preventDefault());

/** The mistakes in a refusal, each with its line. */
function mistakes(text) {
  return text.split("\n").map((line) => {
    const [, where, number] = line.match(/(\S+\.ya?ml):(\d+)(?::\d+)?/) ?? [];
    return { text: line, file: where, line: Number(number) || 0 };
  });
}

function List({ manifests, chosen, choose }) {
  const [filter, setFilter] = useState("");
  const shown = manifests.filter((one) => `${one.kind} ${one.name} ${one.file}`.toLowerCase().includes(filter.toLowerCase()));
  return html`<div class="list"><label class="filter">Filter <input type="search" value=${filter}
      onInput=${(event) => setFilter(event.target.value)} /></label>
    <ul class="scroll" tabindex="0" aria-label="Manifests">${shown.map((one) => html`<li key=${keyOf(one)}>
      <button class="link" aria-current=${chosen && keyOf(chosen) === keyOf(one) ? "true" : undefined}
        onClick=${() => choose(one)}>${one.kind} ${one.name}</button>
      ${drafts.has(keyOf(one)) && html` <span class="quiet">not committed</span>`}
    </li>`)}</ul></div>`;
}

/** The text of a manifest as it is typed, the text that was loaded (`before`), and the digest of that (`base`). */
function useDraft(manifest, path, noted) {
  const key = keyOf(manifest);
  const [draft, setDraft] = useState(drafts.get(key) ?? null);
  const [error, setError] = useState("");
  const typed = draft !== null && draft.text !== draft.before;
  const changed = draft !== null && draft.base !== manifest.digest;
  const put = (next) => {
    if (next.text === next.before) drafts.delete(key);
    else drafts.set(key, next);
    setDraft(next);
    noted();
  };
  // The digest is older than the text, if they differ at all: then a commit is refused, and nothing is overwritten.
  const read = async () => {
    const base = manifest.digest;
    const text = base === null ? "" : await call("GET", path);
    return { text, before: text, base };
  };
  useEffect(() => {
    if (typed || (draft && !changed)) return undefined;
    let current = true;
    read().then((loaded) => current && put(loaded), (refusal) => current && setError(refusal.message));
    return () => {
      current = false;
    };
  }, [manifest.digest, typed]);
  return { draft, put, read, error, typed, overtaken: typed && changed };
}

/** Says that someone else changed the file, and lets the person choose whose text goes on. */
function Overtaken({ manifest, draft, put, read }) {
  const [theirs, setTheirs] = useState(null);
  const [error, setError] = useState("");
  const shown = theirs?.base === manifest.digest ? theirs : null;
  const use = (then) => () => read().then(then, (refusal) => setError(refusal.message));
  return html`<div class="overtaken" role="alert">
    <p class="refusal">${manifest.file} was ${manifest.digest === null ? "deleted" : "changed"} meanwhile. ${error}</p>
    <div class="buttons">
      <button type="button" onClick=${use(setTheirs)}>Show theirs</button>
      <button type="button" onClick=${use((loaded) => put({ ...loaded, text: draft.text }))}>Keep mine on top of theirs</button>
      <button type="button" onClick=${use(put)}>Take theirs</button>
    </div>
    ${shown && html`<pre class="log" tabindex="0" role="region" aria-label="Their text of ${manifest.file}">${shown.text}</pre>`}
  </div>`;
}

function Editor({ manifest, saved, noted, refresh }) {
  const path = `/v1/manifests/${encode(manifest.kind)}/${encode(manifest.name)}`;
  const { draft, put, read, error, typed, overtaken } = useDraft(manifest, path, noted);
  const [found, setFound] = useState([]);
  const [told, setTold] = useState("");
  const [message, setMessage] = useState("");
  const gutter = useRef(null);
  useEffect(() => {
    setFound([]);
    if (!typed || overtaken || state.readOnly) return undefined;
    let current = true;
    const timer = setTimeout(() => {
      call("PUT", path, { text: draft.text, base: draft.base, check: true }).catch((refusal) => {
        if (!current) return;
        const all = mistakes(refusal.cause);
        setFound(all);
        if (!all.some((one) => one.file)) refresh(); // not a mistake in a file: perhaps the version has changed
      });
    }, PAUSE);
    return () => {
      current = false;
      clearTimeout(timer);
    };
  }, [draft, overtaken]);
  const commit = async (event) => {
    event.preventDefault();
    const { text, base } = draft;
    const why = message || `edit ${manifest.kind.toLowerCase()} ${manifest.name}`;
    try {
      const { digest, file } = await call("PUT", path, { text, base, message: why });
      put({ text, before: text, base: digest });
      setMessage("");
      setTold("Committed.");
      saved({ ...manifest, digest, file });
    } catch (refusal) {
      setTold("");
      setFound(mistakes(refusal.cause));
      refresh();
    }
  };
  if (draft === null) return html`<p class="quiet">${error || "Reading."}</p>`;
  const { text, before } = draft;
  const marked = new Set(found.map((one) => one.line));
  return html`<form class="editor" onSubmit=${commit}>
    <h2>${manifest.file}</h2>
    ${overtaken && html`<${Overtaken} manifest=${manifest} draft=${draft} put=${put} read=${read} />`}
    <div class="code">
      <pre class="gutter" ref=${gutter} aria-hidden="true">${text.split("\n").map((_, index) => html`<span key=${index}
        class=${marked.has(index + 1) ? "wrong" : ""}>${marked.has(index + 1) ? "▲" : ""}${index + 1}${"\n"}</span>`)}</pre>
      <textarea aria-label=${`Text of ${manifest.file}`} spellcheck="false" readonly=${state.readOnly} value=${text}
        rows=${Math.min(40, text.split("\n").length + 1)}
        onInput=${(event) => { setTold(""); put({ ...draft, text: event.target.value }); }}
        onScroll=${(event) => { gutter.current.scrollTop = event.target.scrollTop; }}></textarea>
    </div>
    <div role="status"><ul class="mistakes">${found.map((one) => html`<li key=${one.text} class="refusal">${one.text}</li>`)}</ul></div>
    ${!state.readOnly && html`<div class="buttons">
      <label>Message <input value=${message} onInput=${(event) => setMessage(event.target.value)} /></label>
      <button type="button" disabled=${!typed} onClick=${() => put({ ...draft, text: before })}>Undo</button>
      <button class="primary" disabled=${!typed || overtaken || found.length > 0}>Commit</button>
    </div>`}
    <p role="status">${told}</p>
  </form>`;
}

export function Manifests() {
  const { status } = useStore("status");
  const [manifests, setManifests] = useState([]);
  const [chosen, setChosen] = useState(null);
  const [error, setError] = useState("");
  const [, draw] = useState(0);
  // A manifest that is gone stays chosen while it has text that nobody has committed.
  const found = (all, one) =>
    all.find((other) => keyOf(other) === keyOf(one)) ?? (drafts.has(keyOf(one)) ? { ...one, digest: null } : null);
  const take = (answer) => {
    setError("");
    setManifests(answer);
    setChosen((before) => before && found(answer, before));
  };
  const read = () => call("GET", "/v1/manifests").then(take, (refusal) => setError(refusal.message));
  const saved = (one) => {
    setManifests((before) => before.map((other) => (keyOf(other) === keyOf(one) ? one : other)));
    setChosen(one);
    read();
  };
  useEffect(() => {
    read();
    // A comment changes a text, and nothing that the feed tells.
    const timer = setInterval(() => document.hidden || read(), AGAIN);
    return () => clearInterval(timer);
  }, [status?.tree.fingerprint, status?.tree.revision]);
  return html`<div class="manifests">
    ${error && html`<p class="refusal">${error}</p>`}
    <${List} manifests=${manifests} chosen=${chosen} choose=${setChosen} />
    ${chosen
      ? html`<${Editor} key=${keyOf(chosen)} manifest=${chosen} saved=${saved} refresh=${read} noted=${() => draw((count) => count + 1)} />`
      : html`<p class="quiet">Choose a manifest.</p>`}
  </div>`;
}
