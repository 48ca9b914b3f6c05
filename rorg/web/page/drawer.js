// One service: why it runs or not, what it may do next, its last events and lines, and what its container is made from.

import { html, useEffect, useState } from "/page/vendor/preact.js";
import { call, clock, encode, MOODS, mood, sentence, useGradually, useStore } from "/page/store.js";
import { ask } from "/page/actions.js";

const LINES = 60;
const EVENTS = 12;

/** What rorg answers to a call; asked again whenever `key` changes. */
function useAnswer(path, key) {
  const [answer, setAnswer] = useState({ value: null, error: "" });
  useEffect(() => {
    let current = true;
    call("GET", path).then(
      (value) => current && setAnswer({ value, error: "" }),
      (error) => current && setAnswer({ value: null, error: error.message }),
    );
    return () => {
      current = false;
    };
  }, [path, key]);
  return answer;
}

function Chain({ why, error, open }) {
  if (error) return html`<p class="refusal">${error}</p>`;
  if (!why) return null;
  return html`
    ${why.chain.length
      ? html`<ol class="chain">${why.chain.map(
          (link) => html`<li key=${link.service}><button class="link" onClick=${() => open(link.service)}>${link.text}</button></li>`,
        )}</ol>`
      : html`<p>Nothing active wants it.${why.needed_by.length ? ` These would need it: ${why.needed_by.join(", ")}.` : ""}</p>`}
    <ul>${why.waits.map((text) => html`<li key=${text}>${/^waits /.test(text) ? "It " : /^not (ready|wanted)/.test(text) ? "It is " : ""}${text}</li>`)}
      ${why.rivals.map((rival) => html`<li key=${rival.service}><button class="link" onClick=${() => open(rival.service)}>${rival.text}</button> is active</li>`)}
      ${why.remedies.map((command) => html`<li key=${command}>To let it in: <code>${command}</code></li>`)}
      ${why.cautions.map((text) => html`<li key=${text}>Caution: ${text}</li>`)}</ul>`;
}

function Actions({ name, service, why }) {
  const { readOnly } = useStore("status");
  if (readOnly || !why || !service || service.state === "meta") return null;
  const mine = why.requests.filter((request) => !request.standing); // also those that name a group
  const failed = service.conditions.some((c) => c.type === "Updated" && c.status === "False");
  return html`<div class="buttons">
    ${mine.length
      ? mine.map((request) => html`<button key=${`${request.requester} ${request.id}`} onClick=${() => ask.release(request)}>Release ${request.id}</button>`)
      : html`<button onClick=${() => ask.request(name)}>Request</button>`}
    <button onClick=${() => ask.restart(name)} disabled=${!service.wanted}>Restart</button>
    ${service.held
      ? html`<button onClick=${() => ask.unhold(name)}>End the hold</button>`
      : html`<button onClick=${() => ask.hold(name)}>Hold</button>`}
    ${failed && html`<button onClick=${() => ask.retry(name)}>Retry its change</button>`}
  </div>`;
}

function Transitions({ name }) {
  const { events } = useStore("events");
  const older = useAnswer(`/v1/events?tail=${EVENTS}&service=${encode(name)}`, "");
  const past = typeof older.value === "string" ? older.value.split("\n").filter(Boolean).map((line) => JSON.parse(line)) : [];
  const all = [...past, ...events.filter((event) => event.service === name)];
  const shown = [...new Map(all.map((event) => [event.seq, event])).values()].sort((a, b) => b.seq - a.seq).slice(0, EVENTS);
  return html`<ul class="events">${shown.map(
    (event) => html`<li key=${event.seq}><time datetime=${event.at}>${clock(event.at)}</time> ${event.message}</li>`,
  )}</ul>`;
}

function Log({ name, service }) {
  const [turn, setTurn] = useState(0);
  const { value, error } = useAnswer(`/v1/services/${encode(name)}/logs?tail=${LINES}`, `${service?.incarnation} ${turn}`);
  const lines = typeof value === "string" ? value.split("\n").filter(Boolean).map((line) => JSON.parse(line)) : [value ?? {}];
  const text = lines.map((line) => line.text ?? line.error ?? "");
  return html`<button onClick=${() => setTurn(turn + 1)}>Read again</button>
    ${error
      ? html`<p class="refusal">${error}</p>`
      : html`<pre class="log" tabindex="0" role="region" aria-label="Last lines of ${name}">${
          value === null ? "Reading." : text.join("") || "It has printed nothing."}</pre>`}`;
}

/** What declares a field, or its parts; each once. */
function origins(about, field) {
  const parts = Object.entries(about.sources).filter(([name]) => name === field || name.startsWith(`${field}.`) || name.startsWith(`${field}[`));
  return [...new Set(parts.map(([, source]) => source))].join("; ") || "default";
}

const originsOfOption = (about, option) =>
  ["image", "command"].includes(option) ? origins(about, option) : origins(about, `container.${option}`);

/** The options of a container, one in each row, with where each comes from. */
function Configuration({ name, service }) {
  const { value, error } = useAnswer(`/v1/services/${encode(name)}/description`, service?.container);
  if (error) return html`<p class="refusal">${error}</p>`;
  const about = value?.[0];
  if (!about) return null;
  const own = ["needs", "conflicts", "priority", "restart", "idle"].map((key) => [key, about[key], origins(about, key)]);
  const options = Object.entries(about.container ?? {}).map(([key, option]) => [key, option, originsOfOption(about, key)]);
  return html`<p>${about.description}</p>
    <table><caption class="hidden">Configuration of ${name}</caption>
      <thead><tr><th scope="col">Option</th><th scope="col">Value</th><th scope="col">From</th></tr></thead>
      <tbody>${[...own, ...options].map(([key, option, from]) => html`<tr key=${key}><th scope="row">${key}</th>
        <td><code>${typeof option === "string" ? option : JSON.stringify(option)}</code></td>
        <td class="quiet">${from ?? ""}</td></tr>`)}</tbody></table>`;
}

export function Drawer({ name, close, open }) {
  const { services, status } = useStore("services", "status");
  const service = services[name];
  const one = mood(service);
  const parts = useGradually(4, 1);
  const asked = status?.requests.map((request) => `${request.requester} ${request.id}`).join();
  const key = [service?.why, service?.state, service?.message, service?.wanted, asked].join();
  const { value, error } = useAnswer(`/v1/services/${encode(name)}/why`, key);
  const why = value?.[0];
  useEffect(() => {
    const listener = (event) => event.key === "Escape" && !document.querySelector("dialog[open]") && close();
    addEventListener("keydown", listener);
    return () => removeEventListener("keydown", listener);
  }, []);
  return html`<aside class="drawer" aria-label="Service ${name}">
    <div class="head"><h2><span class="shape ${one}" aria-hidden="true">${MOODS[one].shape}</span> ${name}</h2>
      <button onClick=${close} aria-label="Close">×</button></div>
    <p>${sentence(service)}</p>
    <${Actions} name=${name} service=${service} why=${why} />
    <h3>Why</h3><${Chain} why=${why} error=${error} open=${open} />
    ${parts > 1 && html`<h3>What happened</h3><${Transitions} name=${name} />`}
    ${parts > 2 && html`<h3>Log</h3><${Log} name=${name} service=${service} />`}
    ${parts > 3 && html`<h3>Configuration</h3><${Configuration} name=${name} service=${service} />`}
  </aside>`;
}
