(function () {
  "use strict";
  var dark = JSON.parse(document.getElementById("dark").textContent);
  var scheme = window.matchMedia("(prefers-color-scheme: dark)");
  var printing = false;
  var config = {
    responsive: true,
    displaylogo: false,
    displayModeBar: "hover",
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "resetScale2d"]],
    plotlyServerURL: ""
  };

  function recolour(value) {
    if (typeof value === "string") { return Object.hasOwn(dark, value) ? dark[value] : value; }
    if (Array.isArray(value)) { return value.map(recolour); }
    if (value && typeof value === "object") {
      return Object.fromEntries(Object.entries(value).map(function (entry) {
        return [entry[0], recolour(entry[1])];
      }));
    }
    return value;
  }

  function draw(plot) {
    var spec = JSON.parse(plot.parentElement.querySelector("script").textContent);
    if (scheme.matches && !printing) { spec = recolour(spec); }
    if (printing) { spec.layout.width = Math.min(plot.clientWidth, 680); }
    plot.dataset.drawn = "yes";
    return Plotly.react(plot, spec.data, spec.layout, config);
  }

  var plots = Array.from(document.querySelectorAll(".plot"));
  var observer = new IntersectionObserver(function (entries) {
    entries.forEach(function (entry) {
      if (entry.isIntersecting) {
        observer.unobserve(entry.target);
        draw(entry.target);
      }
    });
  }, { rootMargin: "600px" });

  plots.forEach(function (plot) { observer.observe(plot); });
  scheme.addEventListener("change", function () {
    plots.filter(function (plot) { return plot.dataset.drawn; }).forEach(draw);
  });
  window.addEventListener("beforeprint", function () { printing = true; plots.forEach(draw); });
  window.addEventListener("afterprint", function () { printing = false; plots.forEach(draw); });
})();
