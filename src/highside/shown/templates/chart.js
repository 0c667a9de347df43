// Draws a chart of panels (`shown/screen.py`) by the public interface of BokehJS into an element.
function drawn(chart, target) {
  const { ink, grid } = chart.colours;
  const shared = new Map();
  // in pieces: as one word the beginning would be taken for the template's
  const told = (name, digits) => `@${name}` + "{" + `%.${digits}g}`;
  const values = (kind, packed) =>
    new kind(Uint8Array.from(atob(packed), c => c.charCodeAt(0)).buffer);

  function plain(figure, legend) {
    figure.background_fill_alpha = figure.border_fill_alpha = 0;
    figure.outline_line_color = null;
    figure.toolbar.logo = null;
    for (const lines of figure.grids) [lines.grid_line_color, lines.grid_line_alpha] = [grid, 0.3];
    for (const axis of figure.axes) {
      axis.axis_label_text_color = axis.major_label_text_color = axis.axis_line_color = ink;
      axis.major_tick_line_color = axis.minor_tick_line_color = grid;
      axis.axis_label_text_font_style = "normal";
    }
    figure.add_layout(legend, "above");
  }

  function line(figure, source, one, k) {
    const field = name => ({ field: `${name}${k}` });
    const [low, high, y, x] = [field("low"), field("high"), field("y"), { field: "x" }];
    const points = one.look === "points";
    if (one.low && points) figure.segment(x, low, x, high, { source, line_color: one.colour, line_width: 1.5 });
    else if (one.low) figure.varea(x, low, high, { source, fill_color: one.colour, fill_alpha: 0.25 });
    if (points) return figure.scatter(x, y, { source, color: one.colour, size: one.size });
    return figure.line(x, y, { source, line_color: one.colour, line_dash: one.look === "dashed" ? [6] : [] });
  }

  function panel(given) {
    const along = given.names ? undefined : shared.get(given.x_label);
    const figure = new Bokeh.Plotting.Figure({
      height: given.height,
      sizing_mode: "stretch_width",
      tools: "box_zoom,pan,xwheel_zoom,ywheel_zoom,reset,save",
      x_axis_label: given.x_label || null,
      y_axis_label: given.y_label || null,
      y_axis_type: given.log ? "log" : "linear",
      min_border_left: given.left,
      min_border_right: given.right,
      ...(along ? { x_range: along } : {}),
    });
    if (given.x_label && !given.names && !along) shared.set(given.x_label, figure.x_range);
    const data = { x: values(Float64Array, given.x) };
    given.lines.forEach((one, k) => {
      for (const name of ["y", "low", "high"]) if (one[name]) data[`${name}${k}`] = values(Float32Array, one[name]);
    });
    if (given.names) {
      data.name = given.names;
      const ticker = new Bokeh.FixedTicker({ ticks: [...data.x] });
      for (const lines of figure.xgrids) lines.ticker = ticker;
      for (const axis of figure.xaxes) {
        axis.ticker = ticker;
        axis.major_label_overrides = new Map(given.names.map((name, k) => [data.x[k], name]));
      }
    }
    const source = new Bokeh.ColumnDataSource({ data });
    const renderers = given.lines.map((one, k) => line(figure, source, one, k));
    const points = given.lines.some(one => one.look === "points");
    const numbers = ["x", ...given.lines.map((_, k) => `y${k}`)];
    figure.add_tools(new Bokeh.HoverTool({
      renderers: points ? renderers : renderers.slice(0, 1),
      mode: points ? "mouse" : "vline",
      tooltips: [
        [given.x_label || "x", given.names ? "@name" : told("x", 10)],
        ...given.lines.map((one, k) => [one.name, told(`y${k}`, 7)]),
      ],
      formatters: Object.fromEntries(numbers.map(name => [`@${name}`, "printf"])),
    }));
    plain(figure, new Bokeh.Legend({
      items: given.lines.map((one, k) => new Bokeh.LegendItem({ label: one.name, renderers: [renderers[k]] })),
      background_fill_alpha: 0,
      border_line_color: null,
      label_text_color: ink,
      label_text_font_size: "9pt",
      spacing: 2,
      click_policy: "hide",
      location: "top_left",
      orientation: "horizontal",
    }));
    return figure;
  }

  const rows = chart.panels.map(given => [panel(given)]);
  const whole = Bokeh.Plotting.gridplot(rows, { sizing_mode: "stretch_width", toolbar_location: "right" });
  // one tool for all panels: the first of each kind tells which
  whole.toolbar.active_drag = whole.toolbar.tools.find(tool => (tool.tools?.[0] ?? tool) instanceof Bokeh.BoxZoomTool);
  return Bokeh.Plotting.show(whole, target);
}
