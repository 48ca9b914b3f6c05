// The manifests: read, change with the mistakes of the whole tree at once, and commit.

import { html, useEffect, useRef, useState } from "/page/vendor/preact.js";
import { call, encode, state, useStore } from "/page/store.js";

const PAUSE = 500;

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
    <ul class="scroll" tabindex="0" aria-label="Manifests">${shown.map((one) => html`<li key=${one.kind + one.name}>
      <button class="link" aria-current=${chosen === one ? "true" : undefined} onClick=${() => choose(one)}>${one.kind} ${one.name}</button>
    </li>`)}</ul></div>`;
}

function Editor({ manifest, saved }) {
  const path = `/v1/manifests/${encode(manifest.kind)}/${encode(manifest.name)}`;
  const [text, setText] = useState(null);
  const [before, setBefore] = useState("");
  const [found, setFound] = useState([]);
  const [told, setTold] = useState("");
  const [message, setMessage] = useState("");
  const gutter = useRef(null);
  useEffect(() => {
    call("GET", path).then(
      (answer) => {
        setText(answer);
        setBefore(answer);
      },
      (error) => setTold(error.message),
    );
  }, [path]);
  useEffect(() => {
    if (text === null || text === before || state.readOnly) {
      setFound([]);
      return undefined;
    }
    const timer = setTimeout(() => {
      call("PUT", path, { text, base: manifest.digest, check: true }).then(
        () => setFound([]),
        (error) => setFound(mistakes(error.cause)),
      );
    }, PAUSE);
    return () => clearTimeout(timer);
  }, [text, before]);
  const commit = async (event) => {
    event.preventDefault();
    try {
      await call("PUT", path, { text, base: manifest.digest, message });
      setBefore(text);
      setTold("Committed.");
      saved();
    } catch (error) {
      setTold("");
      setFound(mistakes(error.cause));
    }
  };
  if (text === null) return html`<p class="quiet">${told || "Reading."}</p>`;
  const marked = new Set(found.map((one) => one.line));
  return html`<form class="editor" onSubmit=${commit}>
    <h2>${manifest.file}</h2>
    <div class="code">
      <pre class="gutter" ref=${gutter} aria-hidden="true">${text.split("\n").map((_, index) => html`<span key=${index}
        class=${marked.has(index + 1) ? "wrong" : ""}>${marked.has(index + 1) ? "▲" : ""}${index + 1}${"\n"}</span>`)}</pre>
      <textarea aria-label=${`Text of ${manifest.file}`} spellcheck="false" readonly=${state.readOnly} value=${text}
        rows=${Math.min(40, text.split("\n").length + 1)}
        onInput=${(event) => setText(event.target.value)}
        onScroll=${(event) => { gutter.current.scrollTop = event.target.scrollTop; }}></textarea>
    </div>
    <div role="status"><ul class="mistakes">${found.map((one) => html`<li key=${one.text} class="refusal">${one.text}</li>`)}</ul></div>
    ${!state.readOnly && html`<div class="buttons">
      <label>Message <input value=${message} onInput=${(event) => setMessage(event.target.value)} /></label>
      <button type="button" disabled=${text === before} onClick=${() => setText(before)}>Undo</button>
      <button class="primary" disabled=${text === before || found.length > 0}>Commit</button>
    </div>`}
    <p role="status">${told}</p>
  </form>`;
}

export function Manifests() {
  const { status } = useStore("status");
  const [manifests, setManifests] = useState([]);
  const [chosen, setChosen] = useState(null);
  const [error, setError] = useState("");
  const read = () =>
    call("GET", "/v1/manifests").then(
      (answer) => {
        setManifests(answer);
        setChosen((before) => before && (answer.find((one) => one.kind === before.kind && one.name === before.name) ?? null));
      },
      (refusal) => setError(refusal.message),
    );
  useEffect(() => {
    read();
  }, [status?.tree.fingerprint]);
  return html`<div class="manifests">
    ${error && html`<p class="refusal">${error}</p>`}
    <${List} manifests=${manifests} chosen=${chosen} choose=${setChosen} />
    ${chosen
      ? html`<${Editor} key=${chosen.kind + chosen.name} manifest=${chosen} saved=${read} />`
      : html`<p class="quiet">Choose a manifest.</p>`}
  </div>`;
}
