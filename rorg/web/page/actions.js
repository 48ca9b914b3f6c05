// What a person does. Each action first shows what rorg says it would change, then asks, and shows a refusal with its
// cause.

import { html, useEffect, useRef, useState } from "/page/vendor/preact.js";
import { call, encode, useStore } from "/page/store.js";
import { sentences } from "/page/consequences.js";

const AGAIN = 500;

let show = () => {};

/** The actions. Each opens the dialog. `preview` is the question to rorg; `about` is what holds in any case. */
export const ask = {
  request(name) {
    show({
      title: `Request ${name}`,
      preview: { operation: "request", services: [name], id: name },
      about: "It stays until you release it.",
      fields: [["reason", "Reason", ""]],
      verb: "Request",
      run: ({ reason }) => call("PUT", `/v1/requests/${encode(name)}`, { services: [name], reason }),
    });
  },
  release({ id, requester }) {
    show({
      title: `Release ${id}`,
      preview: { operation: "release", id },
      requester,
      verb: "Release",
      run: (_, force) => call("DELETE", `/v1/requests/${encode(id)}?requester=${encode(requester)}&force=${force}`),
    });
  },
  restart(name) {
    show({
      title: `Restart ${name}`,
      preview: { operation: "restart", services: [name] },
      verb: "Restart",
      run: (_, force) => call("POST", `/v1/services/${encode(name)}/restart?force=${force}`),
    });
  },
  hold(name) {
    show({
      title: `Hold ${name}`,
      preview: { operation: "hold", services: [name] },
      about: `Keeps ${name} from being active for so long, even if it is requested.`,
      fields: [["minutes", "Minutes", "10"], ["reason", "Reason", ""]],
      verb: "Hold",
      run: ({ minutes, reason }, force) =>
        call("PUT", `/v1/holds/${encode(name)}`, { duration: `${minutes}m`, reason, force }),
    });
  },
  unhold(name) {
    show({
      title: `End the hold of ${name}`,
      preview: { operation: "unhold", services: [name] },
      verb: "End the hold",
      run: () => call("DELETE", `/v1/holds/${encode(name)}`),
    });
  },
  suspend() {
    show({
      title: "Suspend rorg",
      preview: { operation: "suspend" },
      about: "rorg starts and stops nothing for so long, and restarts nothing that fails.",
      fields: [["minutes", "Minutes", "10"], ["reason", "Reason", ""]],
      verb: "Suspend",
      run: ({ minutes, reason }) => call("PUT", "/v1/suspension", { duration: `${minutes}m`, reason }),
    });
  },
  resume() {
    show({
      title: "End the suspension",
      preview: { operation: "unsuspend" },
      verb: "End the suspension",
      run: () => call("DELETE", "/v1/suspension"),
    });
  },
  retry(name) {
    show({
      title: `Retry the change of ${name}`,
      preview: { operation: "retry", services: [name] },
      about: "If the change fails again, rorg goes back to the previous container.",
      verb: "Retry",
      run: (_, force) => call("POST", "/v1/retries", { services: [name], force }),
    });
  },
};

/** What rorg says that an action would change; asked again whenever a service changes. */
function usePreview(asked) {
  const { services } = useStore("services");
  const [answer, setAnswer] = useState({});
  const known = answer.asked === asked ? answer : {};
  useEffect(() => {
    if (!asked) return undefined;
    let current = true;
    const path = "/v1/preview" + (asked.requester ? `?requester=${encode(asked.requester)}` : "");
    const timer = setTimeout(
      () =>
        call("POST", path, asked.preview).then(
          (told) => current && setAnswer({ asked, told }),
          (error) => current && setAnswer({ asked, error }),
        ),
      known.asked ? AGAIN : 0,
    );
    return () => {
      current = false;
      clearTimeout(timer);
    };
  }, [asked, services]);
  return known;
}

function Preview({ told, error }) {
  if (error) return html`<p class="refusal">${error.message}</p>`;
  if (!told) return html`<p class="quiet">Asking rorg.</p>`;
  return html`${sentences(told).map((line) => html`<p key=${line}>${line}</p>`)}
    ${told.confirm.length > 0 && html`<p class="refusal">Affected: <b>${told.confirm.join(", ")}</b>. ${told.confirm_reason}.</p>`}`;
}

/** The dialog of the action that was chosen last. */
export function Asking() {
  const [asked, setAsked] = useState(null);
  const [values, setValues] = useState({});
  const [refusal, setRefusal] = useState(null);
  const [busy, setBusy] = useState(false);
  const preview = usePreview(asked);
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
  // A person confirms the services that are shown, and no others.
  const shown = [...(preview.told?.confirm ?? []), ...(refusal?.confirm ?? [])];
  const confirmed = shown.length > 0;
  const submit = async (event) => {
    event.preventDefault();
    setBusy(true);
    try {
      await asked.run(values, false).catch((error) => {
        if (!error.confirm?.length || error.confirm.some((name) => !shown.includes(name))) throw error;
        return asked.run(values, true);
      });
      setAsked(null);
    } catch (error) {
      setRefusal(error);
    }
    setBusy(false);
  };
  return html`<dialog ref=${dialog} aria-labelledby="asked" onClose=${() => setAsked(null)}>
    ${asked && html`<form onSubmit=${submit}>
      <h2 id="asked">${asked.title}</h2>
      <div class="preview" aria-live="polite"><${Preview} ...${preview} /></div>
      ${asked.about && html`<p>${asked.about}</p>`}
      ${asked.fields?.map(([name, title]) => html`<label key=${name}>${title}
        <input name=${name} value=${values[name]} onInput=${(e) => setValues({ ...values, [name]: e.target.value })} /></label>`)}
      ${refusal && html`<p class="refusal" role="alert">${refusal.message}
        ${refusal.confirm.length > 0 && html`<br />Affected: <b>${refusal.confirm.join(", ")}</b>`}</p>`}
      <div class="buttons">
        <button type="button" onClick=${() => setAsked(null)}>Cancel</button>
        <button class="primary" disabled=${busy}>${confirmed ? `${asked.verb} all the same` : asked.verb}</button>
      </div>
    </form>`}
  </dialog>`;
}
