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
  const watch = setInterval(() => {
    const opened = window.Bokeh?.documents[0];
    if (!opened) return;
    clearInterval(watch);
    opened.on_event("connection_lost", () => {
      const isLinked = Boolean(model("link")?.text);
      document.getElementById("kept").hidden = !isLinked;
      document.getElementById("unkept").hidden = isLinked;
      document.getElementById("lost").hidden = false;
    });
    document.documentElement.dataset.ready = "yes";
  }, 50);
})();
