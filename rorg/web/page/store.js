// What the page knows of the robot. The feed tells changes; views subscribe to the names of what they show.

import { useEffect, useState } from "/page/vendor/preact.js";

const SAMPLES = 900;
const EVENTS = 500;

export const state = {
  services: {},
  status: null,
  graph: { services: [], edges: [] },
  machines: [],
  events: [],
  samples: [],
  lost: "the page is connecting",
  readOnly: false,
};
const listeners = new Map();

function changed(names) {
  for (const name of names) for (const listener of listeners.get(name) ?? []) listener();
}

const due = new Set();

/** Draw one part of the page, and the next one in the next frame, so that no frame takes long. */
function drawNext() {
  const [draw] = due;
  due.delete(draw);
  if (due.size) requestAnimationFrame(drawNext);
  draw?.();
}

/** Return the state, and draw the caller again whenever one of these parts changes: at most once a frame. */
export function useStore(...names) {
  const [, set] = useState(0);
  useEffect(() => {
    const draw = () => set((count) => count + 1);
    const listener = () => {
      if (!due.size) requestAnimationFrame(drawNext);
      due.add(draw);
    };
    for (const name of names) listeners.set(name, (listeners.get(name) ?? new Set()).add(listener));
    return () => {
      due.delete(draw);
      for (const name of names) listeners.get(name).delete(listener);
    };
  }, []);
  return state;
}

/** Return how many of so many things to draw: some more in each frame, so that no frame takes long. */
export function useGradually(most, step) {
  const [count, set] = useState(step);
  useEffect(() => {
    if (count >= most) return undefined;
    const frame = requestAnimationFrame(() => set(count + step));
    return () => cancelAnimationFrame(frame);
  }, [count, most]);
  return Math.min(count, most);
}

function take(message) {
  const names = [];
  if (message.services) {
    const services = message.whole ? {} : { ...state.services };
    for (const [name, service] of Object.entries(message.services)) {
      if (service) services[name] = service;
      else delete services[name];
    }
    state.services = services;
    names.push("services");
  }
  for (const name of ["status", "graph", "machines", "lost"]) {
    if (name in message) {
      state[name] = message[name];
      names.push(name);
    }
  }
  for (const [name, most] of [["events", EVENTS], ["samples", SAMPLES]]) {
    if (message[name]?.length) {
      state[name] = (message.whole ? message[name] : [...state[name], ...message[name]]).slice(-most);
      names.push(name);
    }
  }
  // Only the last two tell what each service uses now.
  for (const sample of state.samples.slice(-4, -2)) sample.services = {};
  changed(names);
}

/** Follow the feed while the page is seen: a browser has few connections for all of its tabs. */
export function connect() {
  let source = follow();
  document.addEventListener("visibilitychange", () => {
    source.close();
    if (!document.hidden) source = follow();
  });
}

function follow() {
  const source = new EventSource("/feed");
  source.onmessage = (event) => take(JSON.parse(event.data));
  source.addEventListener("page", (event) => {
    state.readOnly = JSON.parse(event.data).read_only;
    changed(["status"]);
  });
  source.onerror = () => {
    state.lost = "the page has lost its server: `rorg ui` has ended";
    changed(["lost"]);
  };
  return source;
}

/** A refusal of rorg: `confirm` are the services that it would affect with force. */
export class Refusal extends Error {
  constructor(told) {
    super([told.cause, told.remedy && `Try ${told.remedy}.`].filter(Boolean).join(". "));
    this.cause = told.cause ?? "";
    this.confirm = told.confirm ?? [];
  }
}

/** Call the API of rorg; return its answer. Throws a Refusal. */
export async function call(method, path, body) {
  const options = { method, headers: {} };
  if (body !== undefined) {
    options.body = JSON.stringify(body);
    options.headers["content-type"] = "application/json";
  }
  let answer;
  try {
    answer = await fetch(`/api${path}`, options);
  } catch {
    throw new Refusal({ cause: "the page has lost its server" });
  }
  if (!answer.ok) throw new Refusal({ cause: await answer.text() });
  const told = await answer.json();
  if (told.refused) throw new Refusal(told.refused);
  return told.answer;
}

export const encode = encodeURIComponent;

// -- words -------------------------------------------------------------------------------------------------------

/** How a service is, in one word with a shape of its own; colours alone would not tell everyone. */
export function mood(service) {
  if (!service) return "none";
  if (service.state === "meta" || service.state === "stopping") return service.state;
  if (service.health === "Degraded" || service.conditions.some((c) => c.type === "Stalled" && c.status === "True"))
    return "failing";
  if (service.state === "unknown" || service.health === "Unknown") return "unknown";
  if (service.health === "Preempted" || service.health === "Waiting") return "waiting";
  if (service.health === "Completed") return "completed";
  if (service.state === "running") {
    if (!service.wanted) return "idle";
    return service.conditions.some((c) => c.type === "Ready" && c.status === "True") ? "ready" : "starting";
  }
  if (service.state === "paused" || service.state === "inactive") return "idle";
  if (service.wanted) return "starting";
  return service.state === "none" ? "none" : "stopped";
}

const condition = (service, type) => service.conditions.find((one) => one.type === type);

/** Whether its last change is on trial. */
const onTrial = (service) => condition(service, "Updated")?.status === "Unknown";

/** What keeps a service from being as wanted; or how long it lingers, or what its trial waits for. */
export function about(service) {
  const waits = onTrial(service) || (!service.wanted && service.health === "Idle");
  return service.message || (waits && condition(service, "Reconciling")?.message) || "";
}

/** How a service is, in a sentence. */
export function sentence(service) {
  const one = mood(service);
  if (!service || one === "meta") return MOODS[one].text;
  const idle = one === "idle" ? (service.state === "running" ? ", still running" : `, ${service.state}`) : "";
  const more = about(service);
  return MOODS[one].text + idle + (onTrial(service) ? ", on trial" : "") + (more && (one === "ready" ? "; " : ": ") + more);
}

/** What is said of a service or a thing that waits. A reason may begin with a verb of its own, or name the engine. */
export function waiting(who, reason) {
  if (who === "engine") return reason;
  return reason.startsWith("waits ") ? `${who} ${reason}` : `${who}: ${reason}`;
}

export const MOODS = {
  ready: { shape: "●", text: "ready" },
  starting: { shape: "◐", text: "starting" },
  idle: { shape: "◫", text: "idle" },
  completed: { shape: "✓", text: "completed" },
  stopping: { shape: "◌", text: "stopping" },
  stopped: { shape: "○", text: "stopped" },
  waiting: { shape: "◌", text: "kept out" },
  failing: { shape: "▲", text: "failing" },
  unknown: { shape: "?", text: "unknown" },
  none: { shape: "·", text: "no container" },
  meta: { shape: "◇", text: "person" },
};

const TIME = new Intl.DateTimeFormat([], { hour: "2-digit", minute: "2-digit", second: "2-digit", hour12: false });

export const clock = (time) => TIME.format(new Date(time));

export function bytes(number) {
  if (!number) return "–";
  return number > 1 << 30 ? `${(number / 2 ** 30).toFixed(1)} GiB` : `${Math.round(number / 2 ** 20)} MiB`;
}

export function seconds(number) {
  if (number < 90) return `${Math.round(number)} s`;
  if (number < 5400) return `${Math.round(number / 60)} min`;
  return `${(number / 3600).toFixed(1)} h`;
}

/** CPU of each service in cores between the last two samples, and memory in bytes. */
export function usage() {
  const [before, now] = state.samples.slice(-2);
  const use = {};
  for (const [name, one] of Object.entries((now ?? before)?.services ?? {})) {
    const old = before?.services[name];
    const passed = now ? now.at - before.at : 0;
    const cpu = old && passed > 0 ? Math.max(0, (one.cpu_seconds - old.cpu_seconds) / passed) : 0;
    use[name] = { cpu, memory: one.memory };
  }
  return use;
}
