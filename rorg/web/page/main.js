// The frame of the page: which view is shown, what is wrong with the robot as a whole, and the drawer of one service.

import { html, render, useEffect, useState } from "/page/vendor/preact.js";
import { connect, MOODS, mood, useStore } from "/page/store.js";
import { Asking } from "/page/actions.js";
import { Drawer } from "/page/drawer.js";
import { Lanes } from "/page/lanes.js";
import { Manifests } from "/page/manifests.js";
import { Now } from "/page/now.js";

const VIEWS = { now: ["Now", Now], time: ["Over time", Lanes], manifests: ["Manifests", Manifests] };

/** The view and the service in the address: #now/navigation. */
function useAddress() {
  const read = () => {
    const [view, service] = decodeURIComponent(location.hash.slice(1)).split("/");
    return { view: view in VIEWS ? view : "now", service: service || "" };
  };
  const [address, set] = useState(read);
  useEffect(() => {
    const listener = () => set(read());
    addEventListener("hashchange", listener);
    return () => removeEventListener("hashchange", listener);
  }, []);
  const go = (view, service = "") => {
    location.hash = service ? `${view}/${encodeURIComponent(service)}` : view;
  };
  return [address, go];
}

function Counts() {
  const { services } = useStore("services");
  const counts = {};
  for (const service of Object.values(services)) {
    const one = mood(service);
    if (one !== "meta") counts[one] = (counts[one] ?? 0) + 1;
  }
  return html`<ul class="counts" aria-label="Services by state">
    ${Object.keys(MOODS).filter((one) => counts[one]).map(
      (one) => html`<li key=${one} class=${one}><span class="shape" aria-hidden="true">${MOODS[one].shape}</span>${" "}
        ${counts[one]} ${MOODS[one].text}</li>`,
    )}
  </ul>`;
}

/** What is wrong with the robot as a whole, each with its cause. */
function Troubles() {
  const { status, lost, machines } = useStore("status", "lost", "machines");
  const told = [];
  if (lost) told.push(["lost", lost]);
  if (status) {
    if (status.engine.error) told.push(["engine", status.engine.error]);
    if (status.down) told.push(["down", status.down === "down" ? "The robot is down. `rorg up` brings it up." : "The robot is being taken down."]);
    if (status.suspended) told.push(["suspended", `rorg is ${status.suspended}`]);
    for (const error of status.tree.errors.slice(0, 5))
      told.push(["refused", `Refused: ${error.file}:${error.line}:${error.column}: ${error.message}`]);
    if (status.pressure.reason)
      told.push(["pressure", `${status.pressure.reason}: ${status.pressure.measures.join(", ") || (status.pressure.helpless ? "no measure helps" : "no measure yet")}`]);
    for (const [name, why] of Object.entries(status.withheld)) told.push(["withheld", `${name} stays: ${why}`]);
    for (const error of status.requests_errors) told.push(["requests", error]);
  }
  for (const machine of machines)
    if (!["up", "this one"].includes(machine.link)) told.push(["link", `${machine.name}: ${machine.link}`]);
  return html`<div class="troubles" role="status" aria-live="polite">
    ${told.map(([kind, text]) => html`<p key=${kind + text} class=${kind}>${text}</p>`)}
  </div>`;
}

function App() {
  const { status, readOnly } = useStore("status");
  const [{ view, service }, go] = useAddress();
  const [, View] = VIEWS[view];
  const tree = status?.tree;
  return html`
    <header>
      <h1>rorg${tree?.robot ? ` · ${tree.robot}` : ""}</h1>
      <nav aria-label="Views">
        ${Object.entries(VIEWS).map(
          ([name, [title]]) => html`<a key=${name} href="#${name}" aria-current=${name === view ? "page" : undefined}>${title}</a>`,
        )}
      </nav>
      <${Counts} />
      ${tree && html`<p class="revision">${tree.revision || "no revision"} · ${tree.standing?.code || "new"}
        ${readOnly ? " · read only" : ""}</p>`}
    </header>
    <${Troubles} />
    <main class=${service ? "with-drawer" : ""}>
      <section class="view" aria-label=${VIEWS[view][0]}><${View} open=${(name) => go(view, name)} /></section>
      ${service && html`<${Drawer} key=${service} name=${service} close=${() => go(view)} open=${(name) => go(view, name)} />`}
    </main>
    <${Asking} />`;
}

connect();
render(html`<${App} />`, document.body);
