// A worker that places the boxes of the graph, so that the page goes on meanwhile.

importScripts("/page/vendor/dagre.js");

const HEIGHT = 26;
const LETTER = 7.2;
const EDGE = 8;
const ALONE = 900;

onmessage = ({ data: { nodes, edges, number } }) => {
  const graph = new dagre.graphlib.Graph();
  graph.setGraph({ rankdir: "LR", nodesep: 8, ranksep: 46, marginx: 8, marginy: 8 });
  graph.setDefaultEdgeLabel(() => ({}));
  const joined = new Set(edges.flat());
  const size = (name) => ({ width: name.length * LETTER + 34, height: HEIGHT });
  for (const name of nodes) if (joined.has(name)) graph.setNode(name, size(name));
  for (const [from, to] of edges) graph.setEdge(from, to);
  dagre.layout(graph);
  const placed = joined.size ? graph.graph() : { width: 0, height: 0 };
  const boxes = Object.fromEntries(graph.nodes().map((name) => [name, graph.node(name)]));
  // Services without any relation stand in rows below the others.
  const widest = Math.max(placed.width, ALONE);
  let [x, y, right] = [EDGE, placed.height + EDGE, placed.width];
  for (const name of nodes.filter((one) => !joined.has(one))) {
    const { width, height } = size(name);
    if (x > EDGE && x + width > widest) [x, y] = [EDGE, y + height + EDGE];
    boxes[name] = { x: x + width / 2, y: y + height / 2, width, height };
    x += width + EDGE;
    right = Math.max(right, x);
  }
  postMessage({
    number,
    width: nodes.length ? right : 0,
    height: nodes.length ? y + (x > EDGE ? HEIGHT + EDGE : 0) : 0,
    boxes,
    lines: graph.edges().map((edge) => ({ from: edge.v, to: edge.w, points: graph.edge(edge).points })),
  });
};
