"use strict";
// Draws the panels of the page with plotly.js, which lies in it compressed. Colours are looked up in the style sheet at each
// drawing, so that dark screens and paper get their own; sizes come from the page's columns.

const root = document.documentElement;
const touch = !matchMedia("(pointer: fine)").matches; // dragging scrolls the page there, and nothing hovers
const printed = () => root.classList.contains("paper");
const panels = [];

async function loadLibrary() {
  const packed = Uint8Array.from(atob(document.getElementById("library").textContent), (c) => c.charCodeAt(0));
  const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  const script = document.createElement("script");
  script.textContent = await new Response(unpacked).text();
  document.head.append(script);
}

/** Replace names of custom properties, as "--blue", by what they stand for now. */
function coloured(value, style) {
  if (typeof value === "string") return value.startsWith("--") ? style.getPropertyValue(value).trim() : value;
  if (Array.isArray(value)) return value.map((item) => coloured(item, style));
  if (value === null || typeof value !== "object") return value;
  return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, coloured(item, style)]));
}

function layoutOf(panel) {
  const axis = {
    gridcolor: "--grid", zerolinecolor: "--rule", linecolor: "--muted", tickcolor: "--muted", showline: true, ticks: "outside",
    ticklen: 4, automargin: true, nticks: panel.plot.clientWidth < 420 ? 6 : 9, showspikes: false,
  };
  const { xaxis, yaxis, ...rest } = panel.layout;
  return {
    width: panel.plot.clientWidth, height: panel.plot.clientHeight, margin: { l: 48, r: 14, t: touch && !printed() ? 30 : 10, b: 38 },
    paper_bgcolor: "rgba(0,0,0,0)", plot_bgcolor: "rgba(0,0,0,0)", showlegend: false, uirevision: "kept",
    font: { family: "system-ui, 'DejaVu Sans', sans-serif", size: 12, color: "--ink" },
    hoverlabel: { bgcolor: "--card", bordercolor: "--rule", font: { color: "--ink" } },
    modebar: { bgcolor: "rgba(0,0,0,0)", color: "--muted", activecolor: "--accent" },
    dragmode: touch ? false : "zoom",
    xaxis: { ...axis, ...xaxis }, yaxis: { ...axis, ...yaxis }, ...rest,
  };
}

function draw(panel) {
  const style = getComputedStyle(root);
  const data = panel.data.map((trace) => ({ ...trace, visible: !(panel.hidden.has(trace.name) || (trace.meta === "film" && printed())) }));
  panel.width = panel.plot.clientWidth;
  return Plotly.react(panel.plot, coloured(data, style), coloured(layoutOf(panel), style), {
    displaylogo: false, plotlyServerURL: "", displayModeBar: printed() ? false : touch ? true : "hover",
    modeBarButtons: touch ? [["zoomIn2d", "zoomOut2d", "resetScale2d"]] : [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
    toImageButtonOptions: { format: "svg", filename: panel.name },
  });
}

const drawAll = () => Promise.all(panels.map(draw));

/** Show the same span of time in every panel of a group. */
function linkViews(panel) {
  panel.plot.on("plotly_relayout", (change) => {
    if (!Object.keys(change).some((key) => key.startsWith("xaxis."))) return;
    const view = panel.plot.layout.xaxis;
    for (const other of panels) {
      if (other === panel || other.group !== panel.group) continue;
      const { range } = other.plot.layout.xaxis;
      if (range[0] === view.range[0] && range[1] === view.range[1]) continue; // it has heard already
      Plotly.relayout(other.plot, { "xaxis.range": [...view.range] });
    }
  });
}

/** Let the buttons of a legend hide and show what they name. */
function makeLegend(figure, drawn) {
  for (const button of figure.querySelectorAll(".legend button")) {
    button.addEventListener("click", () => {
      const shown = button.getAttribute("aria-pressed") !== "true";
      button.setAttribute("aria-pressed", String(shown));
      for (const panel of drawn) {
        panel.hidden[shown ? "delete" : "add"](button.dataset.name);
        draw(panel);
      }
    });
  }
}

function unpack({ bdata }) {
  return new Float32Array(Uint8Array.from(atob(bdata), (c) => c.charCodeAt(0)).buffer);
}

/** Move the robot along its path: by the slider below it, and by the cursor in any panel over time. */
function makeFilm(figure, panel) {
  const [slider, output] = [figure.querySelector(".film input"), figure.querySelector(".film output")];
  const [time, x, y, heading] = ["time", "x", "y", "heading"].map((name) => unpack(panel.film[name]));
  const parts = panel.data.map((trace, index) => [trace, index]).filter(([trace]) => trace.meta === "film");
  const outlines = parts.map(([trace]) => [trace.x, trace.y].map((numbers) => numbers.bdata ? unpack(numbers) : numbers));
  slider.max = time.length - 1;
  const show = (row) => {
    const [cos, sin] = [Math.cos(heading[row]), Math.sin(heading[row])];
    parts.forEach(([trace], part) => {
      const [bodyX, bodyY] = outlines[part];
      trace.x = Array.from(bodyX, (value, k) => x[row] + cos * value - sin * bodyY[k]);
      trace.y = Array.from(bodyX, (value, k) => y[row] + sin * value + cos * bodyY[k]);
    });
    output.textContent = `${time[row].toFixed(2)} s`;
  };
  const moveTo = (row) => {
    show(row);
    const moved = parts.map(([trace]) => trace);
    Plotly.restyle(panel.plot, { x: moved.map((trace) => trace.x), y: moved.map((trace) => trace.y) }, parts.map(([, index]) => index));
  };
  slider.addEventListener("input", () => moveTo(slider.valueAsNumber));
  panel.follow = (instant_s) => {
    let row = time.findIndex((value) => value >= instant_s);
    if (row < 0) row = time.length - 1;
    slider.value = row;
    moveTo(row);
  };
  show(slider.valueAsNumber);
}

function makeFigure(figure) {
  const drawn = [...figure.querySelectorAll(".plot")].map((plot) => {
    const panel = JSON.parse(plot.nextElementSibling.textContent);
    return { ...panel, plot, hidden: new Set(), name: figure.id };
  });
  panels.push(...drawn);
  makeLegend(figure, drawn);
  for (const panel of drawn) if (panel.film) makeFilm(figure, panel);
}

function linkPanels() {
  const film = panels.find((panel) => panel.follow);
  for (const panel of panels) {
    if (panel.group) linkViews(panel);
    if (panel.group === "time" && film) panel.plot.on("plotly_hover", (event) => film.follow(event.xvals[0]));
  }
}

function followTheScreen() {
  const observer = new ResizeObserver(() => {
    for (const panel of panels) if (panel.plot.clientWidth !== panel.width) draw(panel);
  });
  for (const panel of panels) observer.observe(panel.plot);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", drawAll);
  const toPaper = (wanted) => () => {
    root.classList.toggle("paper", wanted);
    drawAll();
  };
  addEventListener("beforeprint", toPaper(true));
  addEventListener("afterprint", toPaper(false));
}

function makeCopyButtons() {
  for (const button of document.querySelectorAll(".copy")) {
    button.hidden = !navigator.clipboard;
    button.addEventListener("click", async () => {
      await navigator.clipboard.writeText(button.previousElementSibling.textContent);
      button.textContent = "Copied";
    });
  }
}

async function main() {
  makeCopyButtons();
  try {
    await loadLibrary();
  } catch (error) {
    for (const plot of document.querySelectorAll(".plot")) plot.textContent = `This browser cannot draw the figure: ${error}`;
    return;
  }
  document.querySelectorAll("figure").forEach(makeFigure);
  await drawAll();
  linkPanels();
  followTheScreen();
  root.dataset.drawn = "yes";
}

main();
