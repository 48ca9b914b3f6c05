// What runs now: the graph of needs and requests, a table of services, and what the machine is busy with.

import { Component, html, useEffect, useMemo, useState } from "/page/vendor/preact.js";
import { about, bytes, call, MOODS, mood, seconds, usage, useGradually, useStore, waiting } from "/page/store.js";
import { ask } from "/page/actions.js";
import { Graph } from "/page/graph.js";

const ORDER = Object.keys(MOODS);
const COLUMNS = [
  ["name", "Service", (row) => row.service.service],
  ["state", "State", (row) => ORDER.indexOf(row.mood)],
  ["cpu", "CPU", (row) => -(row.use?.cpu ?? -1)],
  ["memory", "Memory", (row) => -(row.use?.memory ?? -1)],
  ["crashes", "Crashes", (row) => -row.service.crashes],
  ["why", "Why", (row) => row.service.why],
];

/** One row. It is drawn again only if its service or its use changed: a robot has 300 of them. */
class Row extends Component {
  shouldComponentUpdate(next) {
    return next.service !== this.props.service || next.cpu !== this.props.cpu || next.memory !== this.props.memory;
  }

  render({ service, cpu, memory, open }) {
    const one = mood(service);
    const more = about(service);
    return html`<tr class=${one}>
      <th scope="row"><button class="link" onClick=${() => open(service.service)}>${service.service}</button>
        ${service.machine && html`<span class="quiet">@${service.machine}</span>`}</th>
      <td><span class="shape" aria-hidden="true">${MOODS[one].shape}</span> ${MOODS[one].text}</td>
      <td class="number">${cpu}</td>
      <td class="number">${memory}</td>
      <td class="number">${service.crashes || ""}</td>
      <td class="why">${service.why}${service.why && more && "; "}<span class=${service.message ? "message" : "quiet"}>${more}</span></td>
    </tr>`;
  }
}

const ROW = 30;
const SHOWN = 40;
const LEASES = 2000;

/** The groups of the manifests, asked for again when these change. */
function useGroups() {
  const { status } = useStore("status");
  const [groups, setGroups] = useState([]);
  const tree = status?.tree.fingerprint;
  useEffect(() => {
    let current = true;
    if (tree) call("GET", "/v1/groups").then((told) => current && setGroups(told), () => {});
    return () => {
      current = false;
    };
  }, [tree]);
  return groups;
}

function Table({ open }) {
  const { services } = useStore("services", "samples");
  const [filter, setFilter] = useState("");
  const [by, setBy] = useState("state");
  const [top, setTop] = useState(0);
  const [chosen, choose] = useState("");
  const groups = useGroups();
  const members = groups.find((group) => group.name === chosen)?.services;
  const use = usage();
  const key = COLUMNS.find(([name]) => name === by)[2];
  const words = filter.toLowerCase().split(/\s+/).filter(Boolean);
  const rows = Object.values(services)
    .filter((service) => service.state !== "meta" && (members?.includes(service.service) ?? true))
    .map((service) => ({ service, mood: mood(service), use: use[service.service] }))
    .filter(({ service, mood: one }) => {
      const text = words.length ? `${service.service} ${one} ${service.machine} ${service.why}`.toLowerCase() : "";
      return words.every((word) => text.includes(word));
    })
    .map((row) => ({ ...row, key: key(row) }))
    .sort((a, b) => (a.key < b.key ? -1 : a.key > b.key ? 1 : a.service.service < b.service.service ? -1 : 1));
  // Only the rows that can be seen, between two that take the place of the others.
  const first = Math.max(0, Math.min(rows.length - SHOWN, Math.floor(top / ROW) - 5));
  const last = Math.min(rows.length, first + useGradually(SHOWN, 10));
  const space = (count) => count > 0 && html`<tr aria-hidden="true" style=${{ height: `${count * ROW}px` }}></tr>`;
  return html`<div class="services">
    <label class="filter">Filter <input type="search" value=${filter} placeholder="name, state, machine"
      onInput=${(event) => setFilter(event.target.value)} /></label>
    ${groups.length > 0 && html` <label>Group <select value=${chosen} onChange=${(event) => choose(event.target.value)}>
      <option value="">all services</option>
      ${groups.map((group) => html`<option key=${group.name} value=${group.name}>${group.name}</option>`)}</select></label>`}
    <div class="scroll" tabindex="0" role="region" aria-label="Table of services"
      onScroll=${(event) => setTop(event.target.scrollTop)}>
      <table aria-rowcount=${rows.length + 1}>
        <caption class="hidden">Services</caption>
        <thead><tr>${COLUMNS.map(
          ([name, title]) => html`<th key=${name} scope="col" aria-sort=${by === name ? "ascending" : undefined}>
            <button class="link" onClick=${() => setBy(name)}>${title}</button></th>`,
        )}</tr></thead>
        <tbody>${space(first)}${rows.slice(first, last).map(
          ({ service, use: one }) => html`<${Row} key=${service.service} service=${service} open=${open}
            cpu=${one ? one.cpu.toFixed(2) : ""} memory=${one ? bytes(one.memory) : ""} />`,
        )}${space(rows.length - last)}</tbody>
      </table>
      ${!rows.length && html`<p class="quiet">No service matches.</p>`}
    </div>
  </div>`;
}

/** Seconds left of each lease, by requester and id: time alone changes them, so the feed does not tell them. */
function useLeases(any) {
  const [left, setLeft] = useState({});
  useEffect(() => {
    if (!any) return undefined;
    const read = () =>
      call("GET", "/v1/requests").then(
        (all) => setLeft(Object.fromEntries(all.map((one) => [`${one.requester} ${one.id}`, one.expires_in]))),
        () => setLeft({}),
      );
    read();
    const timer = setInterval(() => document.hidden || read(), LEASES);
    return () => clearInterval(timer);
  }, [any]);
  return left;
}

function lease(request, left) {
  const more = left[`${request.requester} ${request.id}`];
  return more == null ? `lease of ${seconds(request.ttl)}` : `${seconds(Math.max(0, more))} left of its lease of ${seconds(request.ttl)}`;
}

function budget(limits) {
  const parts = [limits?.cpu != null && `${limits.cpu} cores`, limits?.memory != null && bytes(limits.memory)].filter(Boolean);
  return parts.length ? `budget ${parts.join(", ")}` : "no budget";
}

function Facts() {
  const { status, samples, readOnly } = useStore("status", "samples");
  const left = useLeases(status?.requests.some((request) => request.ttl));
  if (!status) return null;
  const [before, now] = samples.slice(-2).map((sample) => sample.machine);
  const passed = now ? samples.at(-1).at - samples.at(-2).at : 0;
  const cpu = passed > 0 ? (now.cpu_seconds - before.cpu_seconds) / passed : 0;
  const machine = now ?? before;
  const calls = Object.entries(status.in_flight);
  return html`<div class="facts">
    <section aria-labelledby="machine"><h2 id="machine">Machine</h2>
      ${machine && html`<p>CPU ${cpu.toFixed(2)} of ${machine.cores} cores, memory ${bytes(machine.memory)} of
        ${" "}${bytes(machine.memory_total)}</p>
        <p>waiting for CPU ${Math.round(machine.cpu_some)} %, for memory ${Math.round(machine.memory_some)} %</p>`}
      <p>${budget(status.pressure.budget)}; pressure: ${status.pressure.reason || "none"}</p>
      ${!readOnly && (status.suspended
        ? html`<button onClick=${() => ask.resume()}>End the suspension</button>`
        : html`<button onClick=${() => ask.suspend()}>Suspend rorg</button>`)}
    </section>
    <section aria-labelledby="requests"><h2 id="requests">Requests</h2>
      <ul>${status.requests.map(
        (request) => html`<li key=${request.requester + request.id}><b>${request.services.join(", ")}</b> by
          ${" "}${request.requester} <span class="quiet">${request.id}${request.reason ? `, ${request.reason}` : ""}
          ${request.ttl ? `, ${lease(request, left)}` : ""}${request.standing ? ", declared in a manifest" : ""}</span>
          ${" "}${!readOnly && !request.standing && html`<button onClick=${() => ask.release(request)}
            aria-label=${`Release ${request.id}`}>Release</button>`}</li>`,
      )}</ul>
      ${!status.requests.length && html`<p class="quiet">Nobody requests anything.</p>`}
    </section>
    <section aria-labelledby="waits"><h2 id="waits">What rorg does and waits for</h2>
      <ul>${calls.map(([name, verb]) => html`<li key=${name}>${verb} ${name} <span class="quiet">is under way</span></li>`)}
        ${status.plan.actions.map((one, index) => html`<li key=${index}>${status.suspended && "after the suspension: "}${one.verb} ${one.service}
          <span class="quiet"> ${one.reason}</span></li>`)}
        ${status.plan.waitings.map((one, index) => html`<li key=${`w${index}`}>${waiting(one.service, one.reason)}</li>`)}
      </ul>
      ${!calls.length && !status.plan.actions.length && !status.plan.waitings.length && html`<p class="quiet">Nothing to do.</p>`}
    </section>
  </div>`;
}

export function Now({ open }) {
  const table = useMemo(() => html`<${Table} open=${open} />`, []);
  return html`<${Graph} open=${open} /><${Facts} />${table}`;
}
