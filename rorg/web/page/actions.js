// What a person does: each action first shows what it would change, then asks, and shows a refusal with its cause.

import { html, useEffect, useRef, useState } from "/page/vendor/preact.js";
import { call, encode, mood, state } from "/page/store.js";

let show = () => {};

/** Everything that these services need, with themselves. */
function needed(names) {
  const found = new Set();
  const pending = [...names];
  while (pending.length) {
    const name = pending.pop();
    if (found.has(name)) continue;
    found.add(name);
    for (const edge of state.graph.edges) if (edge.from === name && edge.kind === "needs") pending.push(edge.to);
  }
  return found;
}

/** Active services that need this one, directly or through others. */
function relying(name) {
  const found = new Set();
  const pending = [name];
  while (pending.length) {
    const one = pending.pop();
    for (const edge of state.graph.edges)
      if (edge.to === one && edge.kind === "needs" && state.services[edge.from]?.wanted && !found.has(edge.from)) {
        found.add(edge.from);
        pending.push(edge.from);
      }
  }
  return [...found].sort();
}

/** Wanted services that nothing would want without this request. */
function unwanted(request) {
  const others = state.status.requests.filter((r) => !(r.id === request.id && r.requester === request.requester));
  const still = needed(state.graph.always_on);
  let before = -1;
  while (before !== still.size) {
    before = still.size;
    const asked = others.filter((r) => state.services[r.requester]?.state === "meta" || still.has(r.requester));
    for (const name of needed(asked.flatMap((r) => r.services))) still.add(name);
  }
  return [...needed(request.services)].filter((name) => state.services[name]?.wanted && !still.has(name)).sort();
}

const list = (names, otherwise) => (names.length ? names.join(", ") : otherwise);

/** The actions. Each opens the dialog with its plan. */
export const ask = {
  request(name) {
    const starting = [...needed([name])].filter((one) => mood(state.services[one]) !== "ready").sort();
    show({
      title: `Request ${name}`,
      plan: [`Starts: ${list(starting, "nothing, all of it runs already")}.`, "It stays until you release it."],
      fields: [["reason", "Reason", ""]],
      verb: "Request",
      run: ({ reason }) => call("PUT", `/v1/requests/${encode(name)}`, { services: [name], reason }),
    });
  },
  release(request) {
    show({
      title: `Release ${request.id}`,
      plan: [`No longer wanted: ${list(unwanted(request), "nothing, all of it is wanted for other reasons")}.`],
      verb: "Release",
      run: (_, force) =>
        call("DELETE", `/v1/requests/${encode(request.id)}?requester=${encode(request.requester)}&force=${force}`),
    });
  },
  restart(name) {
    show({
      title: `Restart ${name}`,
      plan: [`Stops and starts ${name}.`, `These need it: ${list(relying(name), "nothing that is active")}.`],
      verb: "Restart",
      run: (_, force) => call("POST", `/v1/services/${encode(name)}/restart?force=${force}`),
    });
  },
  hold(name) {
    show({
      title: `Hold ${name}`,
      plan: [
        `Stops or pauses ${name}, as its idle policy says, and keeps it from being active for so long, even if it is requested.`,
        `These need it and go with it: ${list(relying(name), "nothing that is active")}.`,
      ],
      fields: [["minutes", "Minutes", "10"], ["reason", "Reason", ""]],
      verb: "Hold",
      run: ({ minutes, reason }, force) =>
        call("PUT", `/v1/holds/${encode(name)}`, { duration: `${minutes}m`, reason, force }),
    });
  },
  unhold(name) {
    show({
      title: `End the hold of ${name}`,
      plan: [`${name} is active again as soon as something wants it.`],
      verb: "End the hold",
      run: () => call("DELETE", `/v1/holds/${encode(name)}`),
    });
  },
  suspend() {
    show({
      title: "Suspend rorg",
      plan: ["rorg changes nothing for so long. What runs goes on."],
      fields: [["minutes", "Minutes", "10"], ["reason", "Reason", ""]],
      verb: "Suspend",
      run: ({ minutes, reason }) => call("PUT", "/v1/suspension", { duration: `${minutes}m`, reason }),
    });
  },
  resume() {
    show({
      title: "Let rorg go on",
      plan: [`It then does what it waits for: ${list(state.status.plan.actions.map((a) => `${a.verb} ${a.service}`), "nothing")}.`],
      verb: "Go on",
      run: () => call("DELETE", "/v1/suspension"),
    });
  },
  retry(name) {
    show({
      title: `Try the change of ${name} again`,
      plan: [`Replaces ${name} by its last change, and goes back if that fails again.`],
      verb: "Retry",
      run: (_, force) => call("POST", "/v1/retries", { services: [name], force }),
    });
  },
};

/** The dialog of the action that was chosen last. */
export function Asking() {
  const [asked, setAsked] = useState(null);
  const [values, setValues] = useState({});
  const [refusal, setRefusal] = useState(null);
  const [busy, setBusy] = useState(false);
  const dialog = useRef(null);
  show = (action) => {
    setValues(Object.fromEntries((action.fields ?? []).map(([name, , value]) => [name, value])));
    setRefusal(null);
    setAsked(action);
  };
  useEffect(() => {
    if (asked && !dialog.current.open) dialog.current.showModal();
    if (!asked && dialog.current.open) dialog.current.close();
  }, [asked]);
  const confirmed = Boolean(refusal?.confirm.length);
  const submit = async (event) => {
    event.preventDefault();
    setBusy(true);
    try {
      await asked.run(values, confirmed);
      setAsked(null);
    } catch (error) {
      setRefusal(error);
    }
    setBusy(false);
  };
  return html`<dialog ref=${dialog} aria-labelledby="asked" onClose=${() => setAsked(null)}>
    ${asked && html`<form onSubmit=${submit}>
      <h2 id="asked">${asked.title}</h2>
      ${asked.plan.map((line) => html`<p key=${line}>${line}</p>`)}
      ${asked.fields?.map(([name, title]) => html`<label key=${name}>${title}
        <input name=${name} value=${values[name]} onInput=${(e) => setValues({ ...values, [name]: e.target.value })} /></label>`)}
      ${refusal && html`<p class="refusal" role="alert">${refusal.message}
        ${confirmed && html`<br />Affected: <b>${refusal.confirm.join(", ")}</b>`}</p>`}
      <div class="buttons">
        <button type="button" onClick=${() => setAsked(null)}>Cancel</button>
        <button class="primary" disabled=${busy}>${confirmed ? `${asked.verb} all the same` : asked.verb}</button>
      </div>
    </form>`}
  </dialog>`;
}
