// The robot over time: one lane for each service, the requests above, CPU and memory below, all on one axis.

import { html, useEffect, useMemo, useRef, useState } from "/page/vendor/preact.js";
import uPlot from "/page/vendor/uplot.js";
import { call, clock, encode, state, useGradually, useStore } from "/page/store.js";

const TURN = 2000;
const SINGLE = 40;
const RECORDS = 5000;
const ROW = 24;
const SHOWN = 30;
const ROWS = 12;
const LABEL = 150;
const RANGES = [["5 min", 300], ["30 min", 1800], ["3 h", 10800], ["24 h", 86400]];
const STATES = { ready: "ready", running: "starting", restarting: "failing", paused: "idle", inactive: "idle",
  created: "stopped", exited: "stopped", dead: "failing", none: "none" };

const ms = (time) => Date.parse(time);

/** Places on the axis are seconds from here on, so that bars stay as they are while the time that is shown goes on. */
const ORIGIN = Date.now();
const FOREVER = 1e7;
const place = (time) => (time - ORIGIN) / 1000;

/** The range that is shown, in ms. It follows the present until a person zooms or pans. */
function useRange() {
  const [range, setRange] = useState({ length: 300_000, end: null });
  const [now, setNow] = useState(Date.now());
  useEffect(() => {
    const timer = setInterval(() => setNow(Date.now()), 1000);
    return () => clearInterval(timer);
  }, []);
  const end = range.end ?? now;
  const zoom = (factor, at = 1) => {
    const length = Math.min(86_400_000 * 7, Math.max(10_000, range.length * factor));
    const fixed = end - range.length * (1 - at);
    setRange({ length, end: at === 1 && range.end === null ? null : Math.min(now, fixed + length * (1 - at)) });
  };
  const pan = (part) => setRange({ ...range, end: Math.min(now, end + part * range.length) });
  const shown = useMemo(() => ({ begin: end - range.length, end }), [end, range.length]);
  return { shown, begin: shown.begin, end, live: range.end === null, zoom, pan, set: setRange };
}

/** A number that grows every few seconds: what changes many times a second is not asked for as often. */
function useTurn() {
  const [turn, set] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => set((before) => before + 1), TURN);
    return () => clearInterval(timer);
  }, []);
  return turn;
}

/** The spans of some services. Those that changed are asked for again, a few at a time. */
function useSpans(names, since, turn) {
  const { services } = state;
  const [spans, setSpans] = useState({});
  const known = useRef({});
  useEffect(() => {
    const key = names.map((name) => `${services[name]?.state} ${services[name]?.health} ${services[name]?.incarnation}`);
    let current = true;
    const due = names.filter((name, index) => known.current[name] !== key[index] + since);
    const next = async () => {
      while (current && due.length) {
        const name = due.shift();
        try {
          const told = await call("GET", `/v1/timeline/${encode(name)}?since=${encode(new Date(since).toISOString())}`);
          // Also if others are asked for meanwhile: what is known is shown.
          known.current[name] = key[names.indexOf(name)] + since;
          setSpans((before) => ({ ...before, [name]: told.spans }));
        } catch {
          return; // the frame of the page says that rorg does not answer
        }
      }
    };
    next();
    next();
    return () => {
      current = false;
    };
  }, [names.join(), since, turn]);
  return spans;
}

/** Records with those of the time after them. These begin with all requests that are held: of them only what is new is
 * added, and what is missing was released a moment before its record was written. */
export function continued(before, told) {
  const key = ({ requester, id, services }) => `${requester} ${id} ${services.join()}`;
  const open = new Map();
  for (const record of before) {
    const who = `${record.requester} ${record.id}`;
    if (record.services.length) open.set(who, record);
    else open.delete(who);
  }
  const known = new Set([...open.values()].map(key));
  const held = new Set(told.requests.filter((record) => record.at === told.begin).map(key));
  const released = [...open.values()].filter((record) => !held.has(key(record)));
  const ended = released.map((record) => ({ ...record, at: told.begin, services: [] }));
  return [...before, ...ended, ...told.requests.filter((record) => record.at !== told.begin || !known.has(key(record)))];
}

/** What was requested since some time. What is known is kept, and only what is new is asked for. */
function useRequested(since, turn) {
  const [requests, setRequests] = useState([]);
  const known = useRef({ since: Infinity, end: 0 });
  useEffect(() => {
    let current = true;
    const anew = since < known.current.since;
    const from = anew ? since : known.current.end;
    call("GET", `/v1/requested?since=${encode(new Date(from).toISOString())}`).then(
      (told) => {
        if (!current) return;
        known.current = { since: anew ? since : known.current.since, end: ms(told.end) };
        setRequests((before) => (anew ? told.requests : continued(before, told)).slice(-RECORDS));
      },
      () => {},
    );
    return () => {
      current = false;
    };
  }, [since, turn]);
  return requests;
}

/** Bars on the axis. Few are drawn one by one, with their texts; many as one path for each kind. */
function barsOf(spans, pixel, onClick) {
  if (spans.length <= SINGLE)
    return spans.map(({ kind, begin, end, text }) => html`<rect key=${kind + begin} class="bar ${kind}" x=${place(begin)} y="4"
      width=${(end === null ? FOREVER : place(end)) - place(begin)} height=${ROW - 8} onClick=${onClick}><title>${text}</title></rect>`);
  const paths = {};
  let done = -Infinity;
  for (const { kind, begin, end } of spans) {
    const [left, right] = [place(begin), end === null ? FOREVER : place(end)];
    if (right < done) continue;
    paths[kind] = `${paths[kind] ?? ""}M${left} 4H${right}V${ROW - 4}H${left}Z`;
    done = left + pixel; // the next one begins at another pixel
  }
  return Object.entries(paths).map(([kind, path]) => html`<path key=${kind} class="bar ${kind}" d=${path} />`);
}

/** A row of bars under a name. The bars stay as they are; only the window over them moves. */
function Row({ name, title, spans, range, width, label, onClick }) {
  const pixel = (range.end - range.begin) / width / 1000;
  const bars = useMemo(() => barsOf(spans, pixel, onClick), [spans, pixel]);
  const last = spans.findLast((span) => span.begin < range.end && (span.end ?? range.end) > range.begin);
  return html`<div class="lane" role="row">
    <div role="rowheader" class="name" title=${title}>${name}</div>
    <div role="cell"><svg width=${width} height=${ROW} role="img" preserveAspectRatio="none"
      viewBox="${place(range.begin)} 0 ${(range.end - range.begin) / 1000} ${ROW}"
      aria-label=${last ? last.text : `${label}: nothing on record`}>${bars}</svg></div></div>`;
}

const NOTHING = [];

function Lane({ name, spans, range, width, open }) {
  const drawn = useMemo(
    () =>
      (spans ?? NOTHING).filter((span) => STATES[span.state] && STATES[span.state] !== "none").map((span) => ({
        kind: span.failed ? "failing" : STATES[span.state],
        begin: ms(span.begin),
        end: span.end ? ms(span.end) : null,
        text: `${name} ${span.state} from ${clock(span.begin)}${span.end ? ` to ${clock(span.end)}` : ""}${span.why && `: ${span.why}`}`,
      })),
    [spans],
  );
  return html`<${Row} spans=${drawn} range=${range} width=${width} label=${name} onClick=${() => open(name)}
    name=${html`<button class="link" onClick=${() => open(name)}>${name}</button>`} />`;
}

/** The requests by who made them and their id, each with its bars: a record without services is a release. */
function rowsOf(requests) {
  const rows = new Map();
  for (const { at, requester, id, services, reason } of requests) {
    const key = `${requester} ${id}`;
    const what = services.join(", ");
    const row = rows.get(key) ?? { key, requester, what, spans: [] };
    const last = row.spans.at(-1);
    rows.set(key, row);
    if (last?.end === null && last.what === what) continue; // told again, at the beginning of what was asked for
    if (last?.end === null) last.end = ms(at);
    if (!what) continue;
    row.what = what;
    row.spans.push({ kind: "request", begin: ms(at), end: null, what, text: `${what} for ${requester}${reason ? `: ${reason}` : ""}` });
  }
  return [...rows.values()].filter((row) => row.spans.length);
}

function Requests({ requests, range, width }) {
  const rows = useMemo(() => rowsOf(requests), [requests]);
  const seen = rows.filter((row) => row.spans.some((span) => span.begin < range.end && (span.end ?? range.end) > range.begin));
  return html`<div role="table" aria-label="Requests" class="lanes">
    ${seen.slice(-ROWS).map((row) => html`<${Row} key=${row.key} title=${row.key} spans=${row.spans} range=${range} width=${width}
      label=${row.key} name=${html`${row.what} <span class="quiet">${row.requester}</span>`} />`)}
    ${seen.length > ROWS && html`<p class="quiet" role="row"><span role="cell">${seen.length - ROWS} more, made before these</span></p>`}
    ${!seen.length && html`<p class="quiet" role="row"><span role="cell">No requests in this time.</span></p>`}
  </div>`;
}

/** What the machine used before the first sample: minutes, later tens of minutes, from the journal. */
function usePast(since) {
  const [past, setPast] = useState(NOTHING);
  useEffect(() => {
    let current = true;
    const asked = `since=${encode(new Date(since).toISOString())}&services=false`;
    call("GET", `/v1/measured/slots?${asked}`).then((told) => current && setPast(told), () => {});
    return () => {
      current = false;
    };
  }, [since]);
  return past;
}

const FULL = "0000-01-01T00:00:00Z";

/** [times in seconds, cores, GiB] of past slots and live samples; a gap in the record is one in the lines. */
function series(past, samples) {
  const first = samples[0]?.at ?? Infinity;
  const lines = [[], [], []];
  const add = (...point) => point.forEach((value, line) => lines[line].push(value));
  for (const { at, seconds, cores, memory } of past) {
    const begin = ms(at + FULL.slice(at.length)) / 1000;
    if (begin + seconds > first) break;
    if (begin - lines[0].at(-1) > 2 * seconds) add(begin, null, null);
    add(begin + seconds / 2, cores, memory / 2 ** 30);
  }
  samples.slice(1).forEach(({ at, machine }, index) => {
    const before = samples[index];
    const cores = (machine.cpu_seconds - before.machine.cpu_seconds) / Math.max(0.1, at - before.at);
    add(at, Math.max(0, cores), machine.memory / 2 ** 30);
  });
  return lines;
}

/** CPU in cores and memory in GiB. */
function Usage({ range, width, since }) {
  const { samples } = useStore("samples");
  const past = usePast(since);
  const place = useRef(null);
  const plot = useRef(null);
  useEffect(() => {
    const style = getComputedStyle(document.documentElement);
    const colour = (name) => style.getPropertyValue(name).trim();
    const axis = { stroke: colour("--text"), grid: { stroke: colour("--line") }, ticks: { stroke: colour("--line") } };
    plot.current = new uPlot(
      {
        width: Math.max(200, width + LABEL),
        height: 160,
        cursor: { drag: { x: false, y: false } },
        legend: { show: true, live: false },
        scales: { x: { auto: false }, memory: {} },
        axes: [
          { ...axis, values: (_, splits) => splits.map((at) => clock(at * 1000)), space: 80 },
          { ...axis, label: "CPU, cores", labelSize: 20, size: LABEL / 2 - 20 },
          { ...axis, scale: "memory", side: 3, label: "memory, GiB", labelSize: 20, size: LABEL / 2 - 20, grid: { show: false } },
        ],
        padding: [8, 0, 0, 0],
        series: [{}, { label: "CPU", stroke: colour("--ready"), width: 2 }, { label: "memory", scale: "memory", stroke: colour("--request"), width: 2, dash: [6, 3] }],
      },
      [[], [], []],
      place.current,
    );
    return () => plot.current.destroy();
  }, [width]);
  useEffect(() => {
    plot.current.setData(series(past, samples), false);
    plot.current.setScale("x", { min: range.begin / 1000, max: range.end / 1000 });
  }, [samples, past, range.begin, range.end, width]);
  return html`<div ref=${place} class="usage" role="img" aria-label="CPU and memory of the machine over time"></div>`;
}

function useWidth() {
  const [width, setWidth] = useState(600);
  const place = useRef(null);
  useEffect(() => {
    const observer = new ResizeObserver(([entry]) => setWidth(Math.max(120, Math.floor(entry.contentRect.width) - LABEL - 8)));
    observer.observe(place.current);
    return () => observer.disconnect();
  }, []);
  return [place, width];
}

function Events({ range, jump, open }) {
  const { events } = useStore("events");
  const [begin, end] = [range.begin, range.end].map((time) => new Date(time).toISOString());
  const shown = events.filter((event) => event.at >= begin && event.at <= end).slice(-useGradually(40, 10)).reverse();
  return html`<ul class="events scroll" tabindex="0" aria-label="Events">${shown.map(
    (event) => html`<li key=${event.seq}><button class="link" onClick=${() => jump(ms(event.at))}>${clock(event.at)}</button>${" "}
      ${event.service ? html`<button class="link" onClick=${() => open(event.service)}>${event.message}</button>` : event.message}</li>`,
  )}</ul>`;
}

/** The names of all services as a text, which changes only if they do. */
function useNames() {
  const [names, set] = useState("");
  const turn = useTurn();
  useEffect(() => set(Object.keys(state.services).sort().join()), [turn]);
  return names;
}

export function Lanes({ open }) {
  const count = useNames();
  const range = useRange();
  const [place, width] = useWidth();
  const [top, setTop] = useState(0);
  const turn = useTurn();
  const names = useMemo(() => Object.values(state.services).filter((s) => s.state !== "meta").map((s) => s.service).sort(), [count]);
  const first = Math.max(0, Math.min(names.length - SHOWN, Math.floor(top / ROW) - 3));
  const drawn = useGradually(SHOWN, 5);
  const visible = names.slice(first, first + drawn);
  // Steps of a part of the range, so that a lane is not asked for again at every second.
  const step = Math.max(60_000, (range.end - range.begin) / 2);
  const since = Math.floor(range.begin / step) * step - step;
  const spans = useSpans(visible, since, turn);
  const requests = useRequested(since, turn);
  const wheel = (event) => {
    if (!event.ctrlKey && !event.shiftKey) return;
    event.preventDefault();
    if (event.shiftKey) range.pan(Math.sign(event.deltaY || event.deltaX) * 0.1);
    else range.zoom(event.deltaY > 0 ? 1.25 : 0.8, range.live ? 1 : 0.5);
  };
  const jump = (at) => range.set({ length: 60_000, end: Math.min(Date.now(), at + 30_000) });
  return html`<div class="time" ref=${place} onWheel=${wheel}>
    <div class="buttons" role="group" aria-label="Time">
      ${RANGES.map(([text, length]) => html`<button key=${text} onClick=${() => range.set({ length: length * 1000, end: null })}>${text}</button>`)}
      <button onClick=${() => range.pan(-0.5)} aria-label="Earlier">←</button>
      <button onClick=${() => range.pan(0.5)} aria-label="Later">→</button>
      <button onClick=${() => range.zoom(0.5, range.live ? 1 : 0.5)} aria-label="Zoom in">+</button>
      <button onClick=${() => range.zoom(2, range.live ? 1 : 0.5)} aria-label="Zoom out">−</button>
      <button onClick=${() => range.set({ length: range.end - range.begin, end: null })} aria-pressed=${range.live}>Live</button>
      <span class="quiet">${clock(range.begin)} to ${clock(range.end)}</span>
    </div>
    <h2>Requests</h2><${Requests} requests=${requests} range=${range.shown} width=${width} />
    <h2>Services</h2>
    <div class="scroll lanes-scroll" tabindex="0" role="region" aria-label="Lanes of services" onScroll=${(event) => setTop(event.target.scrollTop)}>
      <div role="table" aria-label="Services over time" class="lanes" style=${{ height: `${names.length * ROW}px`, paddingTop: `${first * ROW}px` }}>
        ${visible.map((name) => html`<${Lane} key=${name} name=${name} spans=${spans[name]} range=${range.shown} width=${width} open=${open} />`)}
      </div>
    </div>
    <h2>CPU and memory</h2>${drawn === SHOWN && html`<${Usage} range=${range} width=${width} since=${since} />`}
    <h2>Events</h2>${drawn === SHOWN && html`<${Events} range=${range} jump=${jump} open=${open} />`}
  </div>`;
}
