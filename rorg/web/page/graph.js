// The graph of needs and requests, in layers from who requests to the drivers.

import { Component, html, useEffect, useMemo, useRef, useState } from "/page/vendor/preact.js";
import { MOODS, mood, useGradually, useStore } from "/page/store.js";

const SMALLEST = 0.5;

/** Everything that a node leads to, and everything that leads to it. */
function chainOf(name, edges) {
  const chain = new Set([name]);
  for (const [from, to] of [[0, 1], [1, 0]]) {
    const pending = [name];
    while (pending.length) {
      const one = pending.pop();
      for (const edge of edges)
        if (edge[from] === one && !chain.has(edge[to])) {
          chain.add(edge[to]);
          pending.push(edge[to]);
        }
    }
  }
  return chain;
}

class Node extends Component {
  shouldComponentUpdate(next) {
    return ["state", "box", "lit"].some((name) => next[name] !== this.props[name]);
  }

  render({ name, state, box, lit, open, light }) {
    const { shape, text } = MOODS[state];
    return html`<g class="node ${state} ${lit}" role="button" tabindex="0" aria-label="${name}: ${text}"
      transform="translate(${box.x - box.width / 2} ${box.y - box.height / 2})"
      onClick=${() => open(name)} onKeyDown=${(event) => ["Enter", " "].includes(event.key) && open(name)}
      onMouseEnter=${() => light(name)} onFocus=${() => light(name)}
      onMouseLeave=${() => light("")} onBlur=${() => light("")}>
      <rect width=${box.width} height=${box.height} rx="5" />
      <text x="9" y="17" class="shape">${shape}</text><text x="25" y="17">${name}</text>
    </g>`;
  }
}

function pathOf(points) {
  const [first, ...rest] = points;
  return `M${first.x} ${first.y}${rest.map(({ x, y }) => `L${x} ${y}`).join("")}`;
}

/** All lines of one kind in one path: a robot has hundreds. */
class Lines extends Component {
  shouldComponentUpdate(next) {
    return next.lines !== this.props.lines || next.chain !== this.props.chain || next.live !== this.props.live;
  }

  render({ lines, chain, live }) {
    const kinds = { needs: "", requests: "", "needs lit": "", "requests lit": "" };
    for (const { from, to, points } of lines) {
      const kind = live.get(`${from} ${to}`);
      if (kind) kinds[chain?.has(from) && chain.has(to) ? `${kind} lit` : kind] += pathOf(points);
    }
    return html`<g>${Object.entries(kinds).map(([kind, path]) => html`<path key=${kind} class=${kind} d=${path} />`)}</g>`;
  }
}

/** Places with the boxes of before where these have not moved, so that they are not drawn again. */
function settled(before, now) {
  for (const [name, box] of Object.entries(now.boxes)) {
    const old = before?.boxes[name];
    if (old && ["x", "y", "width", "height"].every((key) => old[key] === box[key])) now.boxes[name] = old;
  }
  return now;
}

/** The last places, for when the graph is shown again. */
let lastPlaces = null;

/** Boxes and lines of a graph, placed by a worker; null until they are. */
function usePlaces(nodes, edges) {
  const [places, setPlaces] = useState(lastPlaces);
  const worker = useRef(null);
  const asked = useRef(0);
  useEffect(() => {
    worker.current = new Worker("/page/layout.js");
    worker.current.onmessage = ({ data }) => {
      if (data.number !== asked.current) return;
      lastPlaces = settled(lastPlaces, data);
      setPlaces(lastPlaces);
    };
    return () => worker.current.terminate();
  }, []);
  useEffect(() => {
    asked.current += 1;
    worker.current.postMessage({ nodes, edges, number: asked.current });
  }, [nodes, edges]);
  return places;
}

/** All edges of this page's time: who requested once keeps a place, so that no box moves when a request comes or goes. */
function useRemembered(graph) {
  const memory = useRef({ services: "", edges: [] });
  return useMemo(() => {
    const services = graph.services.join();
    const before = memory.current.services === services ? memory.current.edges : [];
    const known = new Set(before.map((edge) => edge.join()));
    const added = graph.edges.filter((edge) => edge.kind !== "uses").map((edge) => [edge.from, edge.to]);
    const fresh = added.filter((edge) => !known.has(edge.join()));
    const edges = fresh.length ? [...before, ...new Map(fresh.map((edge) => [edge.join(), edge])).values()] : before;
    memory.current = { services, edges };
    return edges;
  }, [graph]);
}

/** The width that there is for an element. */
function useRoom() {
  const [width, setWidth] = useState(800);
  const [element, setElement] = useState(null);
  useEffect(() => {
    if (!element) return undefined;
    const observer = new ResizeObserver(([entry]) => setWidth(Math.floor(entry.contentRect.width) - 4));
    observer.observe(element);
    return () => observer.disconnect();
  }, [element]);
  return [setElement, width];
}

export function Graph({ open }) {
  const { graph, services, status } = useStore("graph", "services", "status");
  const [lit, setLit] = useState("");
  const [all, setAll] = useState(true);
  const [scale, setScale] = useState(0);
  const [place, room] = useRoom();
  const remembered = useRemembered(graph);
  const live = useMemo(() => new Map(graph.edges.map((edge) => [`${edge.from} ${edge.to}`, edge.kind])), [graph]);
  const shown = useMemo(() => {
    const used = new Set(remembered.flat());
    const nodes = graph.services.filter((name) => services[name]?.state !== "meta" || used.has(name));
    const kept = all ? nodes : nodes.filter((name) => services[name]?.wanted);
    const names = new Set(kept);
    return { nodes: kept, edges: remembered.filter(([from, to]) => names.has(from) && names.has(to)) };
  }, [remembered, all, Object.keys(services).length, all ? "" : Object.values(services).filter((s) => s.wanted).map((s) => s.service).join()]);
  const places = usePlaces(shown.nodes, shown.edges);
  const now = useMemo(() => shown.edges.filter((edge) => live.has(edge.join(" "))), [shown, live]);
  const chain = useMemo(() => (lit ? chainOf(lit, now) : null), [lit, now]);
  const count = useGradually(places ? shown.nodes.length : 0, 15);
  // Of 300 services few change in a second: the others are not even compared.
  const asking = useMemo(() => new Set(now.map(([from]) => from)), [now]);
  const moods = shown.nodes.map((name) => mood(services[name])).map((one, n) => (one !== "meta" || asking.has(shown.nodes[n]) ? one : ""));
  const nodes = useMemo(
    () => shown.nodes.slice(0, count).map((name, index) => moods[index] && places?.boxes[name] && html`<${Node} key=${name} name=${name}
      box=${places.boxes[name]} state=${moods[index]} lit=${chain?.has(name) ? "lit" : ""} open=${open} light=${setLit} />`),
    [shown, places, chain, count, moods.join()],
  );
  if (!status) return html`<p class="quiet">Waiting for the robot.</p>`;
  // Without a scale that somebody chose, the whole width fits as long as it can be read.
  const shrunk = scale || (places?.width ? Math.min(1, Math.max(SMALLEST, room / places.width)) : 1);
  const zoom = (factor) => () => setScale(Math.min(2, Math.max(0.25, shrunk * factor)));
  return html`<figure class="graph" ref=${place}>
    <figcaption>Who needs and requests whom
      <label><input type="checkbox" checked=${!all} onChange=${() => setAll(!all)} /> only what is wanted</label>
      <span role="group" aria-label="Size"><button onClick=${zoom(0.8)} aria-label="Smaller">−</button>
        <button onClick=${zoom(1.25)} aria-label="Larger">+</button> <button onClick=${() => setScale(0)}>Fit</button></span>
    </figcaption>
    <div class="scroll" tabindex="0" role="region" aria-label="Graph of services">
      ${places && html`<div class="sheet" style=${{ width: `${places.width * shrunk}px`, height: `${places.height * shrunk}px` }}>
        <svg width=${places.width || 1} height=${places.height || 1} style=${{ transform: `scale(${shrunk})` }}
          class=${chain ? "dimmed" : ""} role="group" aria-label="Graph of needs and requests">
          <${Lines} lines=${places.lines} chain=${chain} live=${live} />
          ${nodes}
        </svg></div>`}
    </div>
  </figure>`;
}
