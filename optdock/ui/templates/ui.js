"use strict";
(() => {
  const dark = window.matchMedia("(prefers-color-scheme: dark)").matches;
  const url = new URL(window.location);
  if (dark !== (url.searchParams.get("theme") === "dark")) {
    if (dark) url.searchParams.set("theme", "dark"); else url.searchParams.delete("theme");
    window.location.replace(url);
    return;
  }
  const used = new Set(["ArrowLeft", "ArrowRight", "ArrowUp", "ArrowDown", "q", "e", "z", "Delete", "Escape"]);
  let count = 0;
  const model = (name) => window.Bokeh?.documents[0]?.get_model_by_name(name);
  document.getElementById("figure").addEventListener("keydown", (event) => {
    if (!used.has(event.key) || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    const keys = model("keys");
    if (keys) keys.value = `${event.key} ${++count}`;
  });
  // A finger that touches a part drags it; elsewhere it scrolls the page.
  const reach = 14; // pixels, as for the pointer
  const isBeside = (points, x, y) => {
    let isInside = false, least = Infinity;
    points.forEach(([x1, y1], k) => {
      const [x0, y0] = points[(k || points.length) - 1], [dx, dy] = [x1 - x0, y1 - y0];
      if (y0 > y !== y1 > y && x < x0 + (dx * (y - y0)) / dy) isInside = !isInside;
      const along = Math.min(1, Math.max(0, ((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy || 1)));
      least = Math.min(least, Math.hypot(x0 + along * dx - x, y0 + along * dy - y));
    });
    return isInside || least <= reach;
  };
  const isOnPart = ({clientX, clientY}) => {
    const view = Object.values(window.Bokeh?.index ?? {}).find((one) => one.model.name === "scene");
    if (!view) return false;
    const box = view.el.getBoundingClientRect(), {x_scale, y_scale} = view.frame;
    const [x, y] = [clientX - box.left, clientY - box.top];
    const pixel = (a, b) => [x_scale.compute(a), y_scale.compute(b)];
    const of = (name) => model(`${name} data`)?.data ?? {};
    const {x: xs = [], y: ys = []} = of("grips");
    const shapes = ["start body", "dock body", "station", "obstacles"].flatMap((name) =>
      Array.from(of(name).xs ?? [], (along, k) => Array.from(along, (a, i) => pixel(a, of(name).ys[k][i]))));
    const discs = Array.from(xs, (a, k) => pixel(a, ys[k]));
    return discs.some(([a, b]) => Math.hypot(a - x, b - y) <= 2 * reach) || shapes.some((one) => isBeside(one, x, y));
  };
  document.getElementById("figure").addEventListener("touchstart", (event) => {
    if (event.touches.length === 1 && isOnPart(event.touches[0])) event.preventDefault();
  }, {capture: true, passive: false});
  // Bokeh takes a pointer that rests for 0.3 s for a press and ignores its further motion, so that a drag that begins
  // slowly would be lost. No part of the page uses presses.
  document.getElementById("figure").addEventListener("pointerdown", () => {
    const view = Object.values(window.Bokeh?.index ?? {}).find((one) => one.model.name === "scene");
    const gestures = view?.canvas_view?.ui_event_bus?.ui_gestures;
    if (gestures) gestures.constructor.press_threshold = 2 ** 31 - 1;
  }, {capture: true});
  const watch = setInterval(() => {
    const opened = window.Bokeh?.documents[0], roots = opened?.roots() ?? [];
    if (!roots.length || !roots.every((root) => root.id in window.Bokeh.index)) return; // the views are not built yet
    clearInterval(watch);
    opened.on_event("connection_lost", () => {
      const isLinked = Boolean(model("link")?.text);
      document.getElementById("kept").hidden = !isLinked;
      document.getElementById("unkept").hidden = isLinked;
      document.getElementById("lost").hidden = false;
    });
    model("data").text = "built";
    document.documentElement.dataset.ready = "yes";
  }, 50);
})();
