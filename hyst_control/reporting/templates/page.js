(async () => {
  "use strict";
  const charts = [...document.querySelectorAll("figure.chart")].map(place => ({
    place, text: place.firstElementChild.textContent, drawing: document.createElement("div")
  }));
  const dark = window.matchMedia("(prefers-color-scheme: dark)");
  const folded = place => place.closest("details:not([open])");  // it has no width to be drawn in
  const draw = (isDark, all = charts) => Promise.all(all.filter(({ place }) => !folded(place)).map(async ({ place, text, drawing }) => {
    // What is drawn in ink is light on a dark page.
    const { data, layout } = JSON.parse(isDark ? text.replaceAll("#1c2430", "#e6e8ec") : text);
    layout.font.color = isDark ? "#e6e8ec" : "#1c2430";
    layout.hoverlabel = { bgcolor: isDark ? "#1e242d" : "#ffffff" };
    drawing.style.height = "100%";
    if (!drawing.isConnected) place.append(drawing);
    await Plotly.react(drawing, data, layout, { displaylogo: false, responsive: true, displayModeBar: "hover" });
    drawing.removeAllListeners("plotly_click");
    drawing.on("plotly_click", ({ points }) => {  // a point that carries a relative path leads there
      const path = points[0].customdata;
      if (typeof path === "string" && /^[\w%.-][\w%./-]*$/.test(path)) location.assign(path);
    });
    document.body.dataset.drawn = document.querySelectorAll("figure.chart .js-plotly-plot").length;
  }));
  try {
    const packed = Uint8Array.from(atob(document.getElementById("library").textContent), letter => letter.charCodeAt(0));
    const unpacked = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const library = document.createElement("script");
    library.textContent = await new Response(unpacked).text();
    document.head.append(library);
    await draw(dark.matches);
    document.body.dataset.drawn ??= 0;
    document.addEventListener("toggle", event =>
      draw(dark.matches, charts.filter(({ place, drawing }) => !drawing.isConnected && event.target.contains(place))), true);
    dark.addEventListener("change", () => draw(dark.matches));
    window.addEventListener("beforeprint", () => draw(false));
    window.addEventListener("afterprint", () => draw(dark.matches));
  } catch (error) {
    for (const { place } of charts) {
      place.style.height = "auto";
      place.append("This browser cannot draw the figure (" + error + "): a version of 2023 or later can.");
    }
    throw error;
  }
})();
