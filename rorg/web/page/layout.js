// A worker that places the boxes of the graph, so that the page goes on meanwhile.

importScripts("/page/vendor/dagre.js");

const HEIGHT = 26;
const LETTER = 7.2;

onmessage = ({ data: { nodes, edges, number } }) => {
  const graph = new dagre.graphlib.Graph();
  graph.setGraph({ rankdir: "LR", nodesep: 8, ranksep: 46, marginx: 8, marginy: 8 });
  graph.setDefaultEdgeLabel(() => ({}));
  for (const name of nodes) graph.setNode(name, { width: name.length * LETTER + 34, height: HEIGHT });
  for (const [from, to] of edges) graph.setEdge(from, to);
  dagre.layout(graph);
  const { width, height } = graph.graph();
  postMessage({
    number,
    width: nodes.length ? width : 0,
    height: nodes.length ? height : 0,
    boxes: Object.fromEntries(graph.nodes().map((name) => [name, graph.node(name)])),
    lines: graph.edges().map((edge) => ({ from: edge.v, to: edge.w, points: graph.edge(edge).points })),
  });
};
