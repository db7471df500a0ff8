"use strict";
// The page of a town. Its data are the JSON in the element "town"; docs/view.md says what the reader sees.
// Whatever comes from the database is shown as text (textContent), never as markup.
(() => {
  const $ = (id) => document.getElementById(id);
  const town = JSON.parse($("town").textContent);
  const { buildings, parts, blocks, views } = town;

  // Constants --------------------------------------------------------------------------------------------------------

  const DEGREE = 1e7; // steps of a degree
  const GREY = "#b5b8bc"; // a value that is not known
  const OTHERS = "#5d6269"; // classes that have no colour of their own
  const PICKED = "#ff4fa3";
  const CELLS = 64; // of the ground, along each side of the town
  const STEPS = 4 * CELLS; // in which levels spread to cells without buildings
  const SIDE = 128; // of a tile of the ground, pixels
  const MARGIN = 20; // around the whole town, pixels
  const UNKNOWN_M = 0.4; // height of a block whose height is not known
  const MOST_HITS = 30;
  const MOST_LISTED = 100;
  const NONE = -1; // no row, no view
  const NEAR_ZOOM = 15; // from here on a large town shows parts

  // Ordered scales go from light to dark or dark to light; colour-blind readers can order all of them.
  const HEIGHTS = ["#fff6d5", "#fddc8a", "#fdb35a", "#f1803c", "#d2502c", "#9c2b25"];
  const STOREYS = [[1, "#ffffcc"], [2, "#c7e9b4"], [3, "#7fcdbb"], [4, "#41b6c4"], [5, "#1d91c0"], [7, "#225ea8"], [10, "#0c2c84"]];
  const SCALES = ["#00224e", "#35456c", "#666970", "#948e77", "#c8b866", "#fee838"];
  const CHANCES = ["#440154", "#3b528b", "#21918c", "#5ec962", "#fde725"];
  const STATES = [["confirmed", "#0072b2"], ["unsure", "#e69f00"], ["refuted", "#8f8f8f"]];
  const CLASSES = ["#88ccee", "#cc6677", "#ddcc77", "#117733", "#332288", "#aa4499", "#44aa99", "#999933", "#882255"];

  // The town as features -------------------------------------------------------------------------------------------

  const finest = town.scales.length;
  // Lists of a large town are made when they are first needed.
  const lazily = (make, made = null) => () => (made ??= make());
  const grouped = (groups, keys) => {
    const found = groups.map(() => []);
    keys.forEach((group, n) => { if (group !== NONE) found[group].push(n); });
    return found;
  };
  const rowsOf = lazily(() => { // by id: a building of the inventory has a row for each of its versions
    const found = new Map();
    buildings.id.forEach((id, row) => found.set(id, [...(found.get(id) || []), row]));
    return found;
  });
  const versionsOf = (row) => (row === NONE ? [] : rowsOf().get(buildings.id[row]));
  const partsOf = lazily(() => grouped(buildings.id, parts.building));
  const childrenOf = lazily(() => grouped(parts.id, parts.father));
  const states = buildings.values.state || [];
  const stateOf = (row) => STATES.findIndex(([name]) => name === states[row]);
  const tallest = quantile([...buildings.height, ...blocks.height].filter((h) => h !== null), 0.99) / 100 || 1;

  function quantile(values, share) {
    const sorted = Float64Array.from(values).sort();
    return sorted.length ? sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))] : 0;
  }

  const degrees = (x, y) => [(town.origin[0] + x) / DEGREE, (town.origin[1] + y) / DEGREE];

  function ring(steps) {
    let x = 0, y = 0;
    const found = [];
    for (let at = 0; at < steps.length; at += 2) {
      x += steps[at];
      y += steps[at + 1];
      found.push(degrees(x, y));
    }
    found.push(found[0]);
    return found;
  }

  // Blocks of buildings have the numbers of their rows; those of parts follow.
  const partOf = (id) => (id < buildings.id.length ? NONE : blocks.part[id - buildings.id.length]);
  const rowOfBlock = (id) => (id < buildings.id.length ? id : parts.building[partOf(id)]);
  const blocksOf = lazily(() => grouped(buildings.id, [...buildings.id.keys(), ...blocks.part.map((part) => parts.building[part])]));

  function feature(id, shape, low, high, height, more) {
    const values = buildings.values, row = rowOfBlock(id);
    const chance = values.probability ? values.probability[row] : null;
    return {
      id,
      shape,
      properties: {
        row, part: partOf(id), low, high, first: buildings.first[row], after: buildings.after[row], state: stateOf(row),
        height: height === null ? NONE : height / 100, chance: chance === null ? NONE : chance / 1000, ...more,
      },
    };
  }

  // The outlines of a large town are in tiles, with all that the map needs.
  const isTiled = $("near") !== null;
  const features = isTiled ? [] : [
    ...buildings.id.map((_, row) => {
      const own = partsOf()[row];
      const root = own.find((part) => parts.father[part] === NONE);
      const storeys = buildings.values.storeys ? buildings.values.storeys[row] : null;
      return feature(row, buildings.shape[row], 0, own.length ? 0 : finest, buildings.height[row], {
        storeys: storeys === null ? NONE : storeys, kind: root === undefined ? 0 : parts.kind[root], scale: 0,
      });
    }),
    ...blocks.part.map((part, n) => feature(buildings.id.length + n, blocks.shape[n], blocks.low[n], blocks.high[n], blocks.height[n],
      { storeys: parts.storeys[part], kind: parts.kind[part], scale: parts.scale[part] })),
  ];
  // Coordinates are made when a map takes them.
  const asGeoJson = ({ id, shape, properties }) =>
    ({ type: "Feature", id, properties, geometry: { type: "MultiPolygon", coordinates: shape.map((polygon) => polygon.map(ring)) } });

  function boundsOf(numbers) {
    let [west, south, east, north] = [Infinity, Infinity, -Infinity, -Infinity];
    if (isTiled)
      for (const id of numbers) {
        const [x0, y0, x1, y1] = buildings.box[rowOfBlock(id)];
        [west, south, east, north] = [Math.min(west, x0), Math.min(south, y0), Math.max(east, x1), Math.max(north, y1)];
      }
    else for (const id of numbers)
      for (const [shell] of features[id].shape)
        for (let at = 0, x = 0, y = 0; at < shell.length; at += 2) {
          x += shell[at];
          y += shell[at + 1];
          [west, south, east, north] = [Math.min(west, x), Math.min(south, y), Math.max(east, x), Math.max(north, y)];
        }
    return west < Infinity ? [degrees(west, south), degrees(east, north)] : null;
  }

  const corners = town.place.corners.map(([x, y]) => degrees(x, y)); // north-west, then clockwise
  const whole = boundsOf(buildings.id.keys()) || [corners[3], corners[1]];

  // Where a place lies between the corners: shares of the way to the east and to the south.
  function shareOf(lon, lat) {
    const [[x0, y0], [x1, y1], , [x3, y3]] = corners;
    const [ax, ay, bx, by] = [x1 - x0, y1 - y0, x3 - x0, y3 - y0];
    const turn = ax * by - ay * bx;
    return [((lon - x0) * by - (lat - y0) * bx) / turn, ((lat - y0) * ax - (lon - x0) * ay) / turn];
  }

  function metresOf(lon, lat) {
    const [u, v] = shareOf(lon, lat);
    const [west, south, east, north] = town.place.bounds_cm.map((cm) => cm / 100);
    return [west + u * (east - west), north - v * (north - south)];
  }

  // The ground: the levels around the buildings, as cells between the corners --------------------------------------

  // Metres above the lowest cell. Cells without a building take the mean of those beside them, again and again.
  const groundLevels = lazily(() => {
    const sums = new Float64Array(CELLS * CELLS), counts = new Float64Array(CELLS * CELLS);
    (buildings.values.z_ground || []).forEach((level, row) => {
      const [x, y] = isTiled ? buildings.box[row] : buildings.shape[row]?.[0]?.[0] || [0, 0];
      const [u, v] = shareOf(...degrees(x, y)).map((share) => Math.min(CELLS - 1, Math.max(0, Math.floor(share * CELLS))));
      if (level !== null) { sums[v * CELLS + u] += level / 100; counts[v * CELLS + u] += 1; }
    });
    const mean = sums.reduce((a, b) => a + b, 0) / Math.max(1, counts.reduce((a, b) => a + b, 0));
    let levels = sums.map((sum, at) => (counts[at] ? sum / counts[at] : mean));
    for (let step = 0; step < STEPS; step += 1)
      levels = levels.map((level, at) => {
        const [u, v] = [at % CELLS, Math.floor(at / CELLS)];
        const beside = [at - (u > 0), at + (u < CELLS - 1), at - CELLS * (v > 0), at + CELLS * (v < CELLS - 1)];
        return counts[at] ? level : beside.reduce((sum, other) => sum + levels[other], 0) / 4;
      });
    const lowest = levels.reduce((a, b) => Math.min(a, b));
    return levels.map((level) => level - lowest);
  });

  function levelAt(lon, lat) {
    const [x, y] = shareOf(lon, lat).map((share) => Math.min(CELLS - 1.001, Math.max(0, share * CELLS - 0.5)));
    const [u, v] = [Math.floor(x), Math.floor(y)], levels = groundLevels();
    const row = (at) => levels[at] * (1 - x + u) + levels[at + 1] * (x - u);
    return row(v * CELLS + u) * (1 - y + v) + row((v + 1) * CELLS + u) * (y - v);
  }

  // A tile of the ground as MapLibre reads it: an image whose colours are metres (Terrarium).
  async function groundTile({ url }) {
    const [zoom, column, line] = url.split("/").slice(-3).map(Number);
    const canvas = make("canvas", { width: SIDE, height: SIDE }), context = canvas.getContext("2d");
    const image = context.createImageData(SIDE, SIDE);
    for (let at = 0; at < SIDE * SIDE; at += 1) {
      const [x, y] = [(column + (at % SIDE) / SIDE) / 2 ** zoom, (line + Math.floor(at / SIDE) / SIDE) / 2 ** zoom];
      const level = levelAt(360 * x - 180, (Math.atan(Math.sinh(Math.PI * (1 - 2 * y))) * 180) / Math.PI) + 32768;
      image.data.set([Math.floor(level / 256), Math.floor(level) % 256, Math.floor((level % 1) * 256), 255], 4 * at);
    }
    context.putImageData(image, 0, 0);
    const blob = await new Promise((done) => { canvas.toBlob(done); });
    return { data: await blob.arrayBuffer() };
  }

  // What is chosen; the address of the page keeps it ---------------------------------------------------------------

  const many = !town.inventory && views.length > 1;
  const chosen = {
    view: many ? NONE : town.inventory ? views.length - 1 : 0, // NONE: all surveys
    other: NONE, // a second view beside the first one
    colour: "height",
    scale: finest,
    picked: NONE, // the row of a building
    part: NONE,
    hidden: new Set(["reasons", "refuted", "slopes"]),
    dark: window.matchMedia("(prefers-color-scheme: dark)").matches,
  };
  const colours = [["height", "height"], ["storeys", "storeys"], ["scale", "scale"], ["class", "class of land cover"],
    ["probability", "probability"], ["state", "state"], ...(town.inventory && views.length > 1 ? [["change", "change"]] : [])];

  const asNumber = (word, least, most, otherwise) => {
    const value = Number(word);
    return word !== null && Number.isInteger(value) && value >= least && value <= most ? value : otherwise;
  };

  function readAddress() {
    const words = new URLSearchParams(location.hash.slice(1));
    const last = views.length - 1;
    chosen.view = asNumber(words.get("view"), many ? NONE : 0, last, chosen.view);
    chosen.other = asNumber(words.get("other"), 0, last, NONE);
    if (chosen.other === chosen.view) chosen.other = NONE;
    if (colours.some(([name]) => name === words.get("colour"))) chosen.colour = words.get("colour");
    chosen.scale = asNumber(words.get("scale"), 0, finest, chosen.scale);
    if (words.has("theme")) chosen.dark = words.get("theme") === "dark";
    if (words.has("hidden")) chosen.hidden = new Set(words.get("hidden").split(" "));
    chosen.picked = words.has("id") ? rowOf(words.get("id")) : NONE;
    const camera = (words.get("at") || "").split(" ").map(Number);
    return camera.length === 5 && camera.every(Number.isFinite) ? camera : null;
  }

  // The version that is shown, else the last.
  function rowOf(id) {
    const rows = rowsOf().get(id) || [];
    return rows.find((row) => isShown(row)) ?? rows.at(-1) ?? NONE;
  }

  const inView = (row, view) => view === NONE || (buildings.first[row] <= view && view < buildings.after[row]);
  const isShown = (row) => inView(row, chosen.view) || (chosen.other !== NONE && inView(row, chosen.other));

  let waiting = 0;
  function keepAddress() {
    clearTimeout(waiting);
    waiting = setTimeout(() => {
      const map = panes[0].map, { lng, lat } = map.getCenter();
      const at = [lng.toFixed(6), lat.toFixed(6), map.getZoom().toFixed(2), map.getBearing().toFixed(0), map.getPitch().toFixed(0)];
      const words = new URLSearchParams({ at: at.join(" "), view: chosen.view, colour: chosen.colour, scale: chosen.scale });
      if (chosen.other !== NONE) words.set("other", chosen.other);
      if (chosen.picked !== NONE) words.set("id", buildings.id[chosen.picked]);
      words.set("hidden", [...chosen.hidden].join(" "));
      words.set("theme", chosen.dark ? "dark" : "light");
      history.replaceState(null, "", `#${words}`);
    }, 200);
  }

  // Small pieces of the page ---------------------------------------------------------------------------------------

  function make(tag, { text, on, ...attributes } = {}, ...inside) {
    const made = document.createElement(tag);
    if (text !== undefined) made.textContent = text;
    for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
    if (on) made.addEventListener("click", on);
    made.append(...inside);
    return made;
  }

  const say = (words) => { $("status").textContent = words; };
  const metres = (cm, digits = 1) => (cm === null ? "unknown" : `${(cm / 100).toFixed(digits)} m`);
  const viewWords = (view) => {
    if (view === NONE) return "all surveys";
    const { name, date } = views[view];
    return town.inventory ? `${date} · ${name}` : [name, date].filter(Boolean).join(" · ");
  };
  // With two views the earlier one is on the left; surveys come the newest first.
  const pair = () => {
    const two = [chosen.view, chosen.other].sort((a, b) => a - b);
    return town.inventory ? two : two.reverse();
  };
  // The two dates whose changes are shown, or null.
  function dates() {
    if (!town.inventory) return null;
    if (chosen.other !== NONE) return pair();
    return chosen.colour === "change" && chosen.view > 0 ? [chosen.view - 1, chosen.view] : null;
  }
  const changesOf = (two) => (two && town.changes[two.join("-")]) || [];

  // Colours and their legend ---------------------------------------------------------------------------------------

  const ramp = (value, colours, low, high) =>
    ["interpolate", ["linear"], value, ...colours.flatMap((own, n) => [low + ((high - low) * n) / (colours.length - 1), own])];
  const known = (name, colour) => ["case", ["<", ["get", name], 0], GREY, colour];
  // The classes of most parts have colours of their own; the others share one.
  const often = town.classes.map(() => 0);
  parts.kind.forEach((kind) => { often[kind] += 1; });
  const byNumber = [...town.classes.keys()].slice(1).sort((a, b) => often[b] - often[a]);
  const coloured = byNumber.slice(0, CLASSES.length).sort((a, b) => a - b);
  const classColour = (kind) => (kind === 0 ? GREY : CLASSES[coloured.indexOf(kind)] || OTHERS);

  function colourOf(name) {
    const get = ["get", { class: "kind", probability: "chance" }[name] || name];
    switch (name) {
      case "height": return known("height", ramp(get, HEIGHTS, 0, tallest));
      case "storeys": return known("storeys", ["step", get, STOREYS[0][1], ...STOREYS.slice(1).flat()]);
      case "scale": return ["case", ["==", get, 0], GREY, ramp(get, SCALES, 1, Math.max(finest, 2))];
      case "class": return ["match", get, ...town.classes.slice(1).flatMap((_, n) => [n + 1, classColour(n + 1)]), NONE, GREY, GREY];
      case "probability": return known("chance", ramp(get, CHANCES, 0, 1));
      case "state": return ["match", get, ...STATES.flatMap(([, own], n) => [n, own]), GREY];
      default: return ["match", ["coalesce", ["feature-state", "kind"], NONE], ...town.kinds.flatMap(([, own], n) => [n, own]), GREY];
    }
  }

  function key(colour, words) {
    const swatch = make("i");
    swatch.style.background = colour;
    return make("div", { class: "key" }, swatch, make("span", { text: words }));
  }

  function bar(colours, low, high) {
    const made = make("div", { class: "bar", role: "img", "aria-label": `from ${low} to ${high}` });
    made.style.background = `linear-gradient(to right, ${colours.join(", ")})`;
    return [made, make("div", { class: "ends" }, make("span", { text: low }), make("span", { text: high }))];
  }

  function drawLegend() {
    const titles = { height: "Mean height of a block above ground", storeys: "Storeys", scale: "Scale of a part",
      class: "Class of land cover", probability: "Probability of a building", state: "State", change: "Change" };
    $("legend-title").textContent = titles[chosen.colour];
    const shown = { height: () => bar(HEIGHTS, "0 m", `${tallest.toFixed(0)} m and more`),
      storeys: () => STOREYS.map(([from, own], n) => {
        const to = n + 1 < STOREYS.length ? STOREYS[n + 1][0] - 1 : null;
        return key(own, to === null ? `${from} and more` : to === from ? `${from}` : `${from} to ${to}`);
      }),
      scale: () => [...bar(SCALES, "1, coarsest", `${finest}, finest`), key(GREY, "building without parts")],
      class: () => {
        const others = town.classes.filter((_, kind) => classColour(kind) === OTHERS);
        return [...coloured.map((kind) => key(classColour(kind), town.classes[kind])),
          ...(others.length ? [key(OTHERS, others.join(", "))] : []), key(GREY, "none")];
      },
      probability: () => bar(CHANCES, "0", "1"),
      state: () => STATES.map(([words, own]) => key(own, words)),
      change: () => {
        const two = dates(), counts = new Map();
        changesOf(two).forEach(([kind]) => counts.set(kind, (counts.get(kind) || 0) + 1));
        const rows = town.kinds.map(([words, own], kind) => [kind, key(own, `${words}: ${counts.get(kind)}`)]);
        return [...rows.filter(([kind]) => counts.has(kind)).reverse().map(([, row]) => row), key(GREY, "unchanged"),
          make("p", { class: "note", text: two ? `${viewWords(two[0])} to ${viewWords(two[1])}` : "The first date: nothing is older." })];
      } }[chosen.colour]();
    if (["height", "probability", "storeys"].includes(chosen.colour)) shown.push(key(GREY, "not known"));
    if (town.reasons && !chosen.hidden.has("reasons")) {
      shown.push(make("h3", { text: "Why there is no building" }));
      town.reasons.legend.filter(([, colour]) => colour).forEach(([, colour, words]) => shown.push(key(colour, words)));
    }
    $("legend").replaceChildren(...shown);
  }

  // The maps -------------------------------------------------------------------------------------------------------

  const panes = []; // of each: its map, and a function that waits for it
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  // What a pane shows of each layer: which rows, and how. With changes, what is gone by then is shown, too.
  function looks(view, side) {
    const two = dates();
    const gone = two && side === NONE ? changesOf(two).filter(([, , after]) => after === NONE).map(([, before]) => before) : [];
    const filter = filterOf(view, gone);
    const on = ["boolean", ["feature-state", "on"], false];
    const isSeen = (layer) => ({ visibility: chosen.hidden.has(layer) ? "none" : "visible" });
    const layers = [
      { id: "paper", type: "background", paint: { "background-color": css("--ground") } },
      ...(town.ground ? [{ id: "ground", type: "raster", source: "ground", layout: isSeen("ground"),
        paint: { "raster-fade-duration": 0, "raster-opacity": 0.7 } }] : []),
      ...(town.photo ? [{ id: "photo", type: "raster", source: "photo", layout: isSeen("photo"),
        paint: { "raster-fade-duration": 0 } }] : []),
      ...(town.reasons ? [{ id: "reasons", type: "raster", source: "reasons", layout: isSeen("reasons"),
        paint: { "raster-fade-duration": 0, "raster-opacity": 0.75, "raster-resampling": "nearest" } }] : []),
      { id: "outlines", type: "line", source: "town", filter: ["all", ["==", ["get", "part"], NONE], filter],
        layout: isSeen("outlines"), paint: { "line-color": css("--line"), "line-width": 1 } },
      { id: "picked", type: "line", source: "town", layout: { visibility: chosen.picked === NONE ? "none" : "visible" },
        filter: ["all", ["==", ["get", "part"], NONE], ["in", ["get", "row"], ["literal", versionsOf(chosen.picked)]], filter],
        paint: { "line-color": PICKED, "line-width": 3 } },
      { id: "blocks", type: "fill-extrusion", source: "town", filter: ["all", filter, levelOf(chosen.scale)], layout: isSeen("blocks"),
        paint: {
          "fill-extrusion-color": ["case", on, PICKED, colourOf(chosen.colour)],
          "fill-extrusion-height": ["case", ["<", ["get", "height"], 0], UNKNOWN_M, ["get", "height"]],
          "fill-extrusion-vertical-gradient": true } },
    ];
    return isTiled ? layers.flatMap(nearAndFar) : layers;
  }

  // From afar a large town has its buildings alone; their outlines are too small to be seen beside blocks.
  function nearAndFar(layer) {
    if (layer.source !== "town") return [layer];
    const isCovered = layer.id === "outlines" && !chosen.hidden.has("blocks");
    return [{ ...layer, "source-layer": "town", minzoom: NEAR_ZOOM },
      { ...layer, id: `far-${layer.id}`, source: "far", "source-layer": "town", maxzoom: NEAR_ZOOM,
        layout: isCovered ? { visibility: "none" } : layer.layout }];
  }

  function styleOf(view, side) {
    const image = (url, place = corners) => ({ type: "image", url, coordinates: place });
    return {
      version: 8,
      light: { anchor: "map", position: [1.3, 315, 40], intensity: 0.28 },
      sources: {
        ...(isTiled && { far: { type: "vector", url: "pmtiles://far", promoteId: "n" } }),
        town: isTiled ? { type: "vector", url: "pmtiles://near", promoteId: "n" }
          : { type: "geojson", maxzoom: 18, buffer: 32, tolerance: 0.2,
            data: { type: "FeatureCollection", features: features.filter(isEarly).map(asGeoJson) } },
        slopes: { type: "raster-dem", tiles: ["slopes://{z}/{x}/{y}"], tileSize: SIDE, maxzoom: 15, encoding: "terrarium" },
        ...(town.ground && { ground: image(town.ground) }),
        ...(town.photo && { photo: image(town.photo.image, town.photo.corners.map(([x, y]) => degrees(x, y))) }),
        ...(town.reasons && { reasons: image(town.reasons.image) }),
      },
      layers: looks(view, side),
    };
  }
  const placesOf = (id) => (isTiled ? ["town", "far"].map((source) => ({ source, id, sourceLayer: "town" })) : [{ source: "town", id }]);

  // The archives of tiles are in the page, and so in memory.
  function openTiles() {
    const protocol = new pmtiles.Protocol();
    for (const name of ["far", "near"]) {
      const text = atob($(name).textContent), bytes = new Uint8Array(text.length);
      for (let at = 0; at < text.length; at += 1) bytes[at] = text.charCodeAt(at);
      $(name).textContent = "";
      protocol.add(new pmtiles.PMTiles({ getKey: () => name,
        getBytes: async (offset, length) => ({ data: bytes.buffer.slice(offset, offset + length) }) }));
    }
    maplibregl.addProtocol("pmtiles", protocol.tile);
  }

  // Without a graphics card smooth edges cost more than half of the time.
  function isSoftware() {
    const gl = document.createElement("canvas").getContext("webgl2");
    const info = gl.getParameter(gl.RENDERER) === "WebKit WebGL" && gl.getExtension("WEBGL_debug_renderer_info");
    return /swiftshader|llvmpipe|software/i.test(gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  }

  function addPane(camera, view, side) {
    const which = panes.length ? "b" : "a";
    const options = camera ? { center: camera.slice(0, 2), zoom: camera[2], bearing: camera[3], pitch: camera[4] }
      : { center: [(whole[0][0] + whole[1][0]) / 2, (whole[0][1] + whole[1][1]) / 2], zoom: 15 };
    const map = new maplibregl.Map({
      container: `map-${which}`, style: styleOf(view, side), maxPitch: 80, maxZoom: 22, attributionControl: false, renderWorldCopies: false,
      fadeDuration: 0, trackResize: false, canvasContextAttributes: { antialias: !isSoftware() }, ...options,
      locale: { "Map.Title": which === "a" ? "Map of the town" : "Map of the town at the later date" },
    });
    if (!camera) showWhole(map);
    map.addControl(new maplibregl.NavigationControl({ visualizePitch: true }), "bottom-right");
    map.addControl(new maplibregl.ScaleControl({ maxWidth: 140 }), "bottom-right");
    map.on("error", ({ error }) => say(`The map cannot be drawn: ${error.message}`));
    map.on("click", ({ point, lngLat }) => pickAt(map, point, lngLat));
    map.on("mousemove", ({ point }) => { map.getCanvas().style.cursor = blockAt(map, point) ? "pointer" : ""; });
    map.on("move", () => follow(map));
    map.on("moveend", keepAddress);
    map.getCanvas().addEventListener("keydown", (event) => {
      if (event.key !== "Enter") return;
      const middle = map.project(map.getCenter());
      pickAt(map, middle, map.getCenter());
    });
    const ready = new Promise((done) => map.once("load", done));
    if (!isTiled) {
      const late = features.filter((own) => !isEarly(own));
      map.once("idle", () => map.getSource("town").updateData({ add: late.map(asGeoJson) }));
    }
    const pane = { map, ready, which, marked: [] };
    panes.push(pane);
    return pane;
  }

  // The whole town from the south-east, as large as the room beside the panel allows.
  function showWhole(map) {
    const { clientWidth: width, clientHeight: height } = map.getContainer();
    const left = window.innerWidth > 900 && chosen.other === NONE ? 310 : MARGIN;
    const [[west, south], [east, north]] = whole, [wide, high] = [width - left - 2 * MARGIN, height - 4 * MARGIN];
    map.fitBounds(whole, { pitch: 50, bearing: -20, padding: MARGIN, animate: false });
    for (let step = 0; step < 4; step += 1) { // a tilted map has no simple inverse
      const seen = [[west, south], [west, north], [east, south], [east, north]].map((place) => map.project(place));
      const [xs, ys] = [seen.map(({ x }) => x), seen.map(({ y }) => y)];
      const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)];
      map.panBy([(x0 + x1 - left - width + MARGIN) / 2, (y0 + y1 - height) / 2], { animate: false });
      map.setZoom(map.getZoom() + Math.log2(Math.min(wide / (x1 - x0), high / (y1 - y0))));
    }
  }

  let leader = null;
  function follow(map) {
    if (leader || panes.length < 2 || chosen.other === NONE) return;
    leader = map;
    const camera = { center: map.getCenter(), zoom: map.getZoom(), bearing: map.getBearing(), pitch: map.getPitch() };
    panes.forEach((pane) => { if (pane.map !== map) pane.map.jumpTo(camera); });
    leader = null;
  }

  function blockAt(map, point) {
    const layers = ["blocks", "far-blocks"].filter((id) => map.getLayer(id));
    return layers.length ? map.queryRenderedFeatures(point, { layers })[0] || null : null;
  }

  function filterOf(view, gone) {
    const time = view === NONE ? true
      : ["any", ["all", ["<=", ["get", "first"], view], [">", ["get", "after"], view]], ["in", ["get", "row"], ["literal", gone]]];
    const hidden = STATES.map(([name], n) => (chosen.hidden.has(name) ? n : null)).filter((n) => n !== null);
    return ["all", time, ["!", ["in", ["get", "state"], ["literal", hidden]]]];
  }

  // A map begins with the blocks that it shows, and gets the others when these are seen: so the first picture comes in half
  // of the time.
  const isEarly = ({ properties: { low, high } }) => low <= chosen.scale && chosen.scale <= high;

  const levelOf = (scale) => ["all", ["<=", ["get", "low"], scale], [">=", ["get", "high"], scale]];

  async function drawPane(pane, view, side) {
    await pane.ready;
    const { map } = pane, hasSlopes = !chosen.hidden.has("slopes"), changes = changesOf(dates());
    for (const { id, filter, layout, paint } of looks(view, side)) {
      if (filter) map.setFilter(id, filter);
      for (const [name, value] of Object.entries(layout || {})) map.setLayoutProperty(id, name, value);
      for (const [name, value] of Object.entries(paint)) map.setPaintProperty(id, name, value);
    }
    if (hasSlopes !== Boolean(map.getTerrain())) map.setTerrain(hasSlopes ? { source: "slopes" } : null);
    pane.marked.forEach((id) => placesOf(id).forEach((place) => map.removeFeatureState(place)));
    pane.marked = [];
    const mark = (id, state) => { placesOf(id).forEach((place) => map.setFeatureState(place, state)); pane.marked.push(id); };
    for (const [kind, before, after] of changes) {
      const rows = side === 0 ? [before] : side === 1 ? [after] : [before, after];
      rows.filter((row) => row !== NONE).forEach((row) => blocksOf()[row].forEach((id) => mark(id, { kind })));
    }
    for (const row of versionsOf(chosen.picked))
      blocksOf()[row].filter((id) => chosen.part === NONE || row !== chosen.picked || partOf(id) === chosen.part)
        .forEach((id) => mark(id, { on: true }));
    $(`tag-${pane.which}`).textContent = viewWords(view);
    $(`tag-${pane.which}`).hidden = chosen.other === NONE;
  }

  // Only where its size changed: it would end a movement of the camera.
  function fitPanes() {
    for (const { map } of panes) {
      const { clientWidth, clientHeight } = map.getContainer(), canvas = map.getCanvas();
      if (clientWidth && (clientWidth !== canvas.clientWidth || clientHeight !== canvas.clientHeight)) map.resize();
    }
  }

  let drawing = Promise.resolve();
  function draw() {
    const isTwo = chosen.other !== NONE;
    document.documentElement.dataset.theme = chosen.dark ? "dark" : "light";
    document.body.classList.toggle("two", isTwo);
    document.body.classList.toggle("open", !$("details").hidden);
    $("pane-b").hidden = !isTwo;
    if (isTwo && panes.length < 2) {
      const { lng, lat } = panes[0].map.getCenter(), from = panes[0].map;
      addPane([lng, lat, from.getZoom(), from.getBearing(), from.getPitch()], pair()[1], 1);
    }
    fitPanes();
    drawControls();
    drawLegend();
    drawChanges();
    keepAddress();
    const jobs = isTwo ? panes.map((pane, side) => drawPane(pane, pair()[side], side)) : [drawPane(panes[0], chosen.view, NONE)];
    drawing = Promise.all(jobs).catch((error) => say(`The map cannot be drawn: ${error.message}`));
    return drawing;
  }

  // The panel ------------------------------------------------------------------------------------------------------

  function scaleWords(scale) {
    if (scale === 0) return "– buildings as blocks";
    const area = town.scales[scale - 1][1];
    return `${scale} of ${finest}${area === null ? "" : `, from ${area.toLocaleString("en")} m²`}`;
  }

  function options(select, rows, value) {
    select.replaceChildren(...rows.map(([own, text]) => make("option", { value: own, text })));
    select.value = value;
  }

  function drawControls() {
    const every = views.map((_, view) => [view, viewWords(view)]);
    const shown = town.inventory ? [...every].reverse() : every;
    options($("view"), [...(many ? [[NONE, "all surveys"]] : []), ...shown], chosen.view);
    options($("other"), [[NONE, "nothing"], ...shown.filter(([view]) => view !== chosen.view)], chosen.other);
    options($("colour"), colours, chosen.colour);
    $("comparing").hidden = views.length < 2 || chosen.view === NONE;
    $("showing").hidden = views.length < 2;
    $("scale").max = finest;
    $("scale").value = chosen.scale;
    $("scale-row").hidden = finest === 0;
    $("scale-words").textContent = scaleWords(chosen.scale);
    $("scale").setAttribute("aria-valuetext", scaleWords(chosen.scale));
    $("theme").textContent = chosen.dark ? "Light" : "Dark";
    $("flat").setAttribute("aria-pressed", String(panes[0].map.getPitch() < 1));
    document.querySelectorAll("#layers input").forEach((box) => { box.checked = !chosen.hidden.has(box.name); });
  }

  function makeLayers() {
    const rows = [["blocks", "buildings in 3-D"], ["outlines", "footprints"],
      ...(town.ground ? [["ground", "light and shadow of the surface"]] : []),
      ...(town.photo ? [["photo", "orthophoto"]] : []),
      ...((buildings.values.z_ground || []).some((level) => level !== null) ? [["slopes", "slopes of the ground"]] : []),
      ...(town.reasons ? [["reasons", "why there is no building"]] : []),
      ...(states.includes("refuted") ? [["refuted", "refuted buildings"]] : [])];
    $("layers").replaceChildren(...rows.map(([name, words]) => {
      const box = make("input", { type: "checkbox", name });
      box.addEventListener("change", () => {
        chosen.hidden[box.checked ? "delete" : "add"](name);
        draw();
      });
      return make("label", {}, box, words);
    }));
  }

  function drawChanges() {
    const two = dates();
    $("changes").hidden = !two;
    if (!two) return;
    const rows = changesOf(two).filter(([kind]) => !["first seen", "unsure"].includes(town.kinds[kind][0]));
    $("changes-title").textContent = `${rows.length} changes from ${views[two[0]].date} to ${views[two[1]].date}`;
    const order = [...rows].sort((a, b) => b[0] - a[0] || Math.abs(b[4] || 0) - Math.abs(a[4] || 0));
    const list = order.slice(0, MOST_LISTED).map(([kind, before, after, height, area]) => {
      const row = after === NONE ? before : after;
      const more = [height === null ? "" : `height ${signed(height / 100, 1)} m`, area ? `area ${signed(area, 0)} m²` : ""];
      const words = [town.kinds[kind][0], ...more.filter(Boolean)].join(" · ");
      return make("li", {}, make("button", { type: "button", text: words, on: () => { pick(row); goTo(row); } }));
    });
    const more = rows.length > MOST_LISTED ? [make("p", { class: "note", text: `The first ${MOST_LISTED} are listed.` })] : [];
    $("change-list").replaceChildren(make("ul", { class: "list tree" }, ...list), ...more);
  }

  const signed = (value, digits) => `${value > 0 ? "+" : value < 0 ? "−" : "±"}${Math.abs(value).toFixed(digits)}`;

  function search() {
    const words = $("query").value.trim();
    const found = [];
    if (words) {
      const seen = new Set();
      buildings.id.forEach((id, row) => {
        if (id.startsWith(words) && !seen.has(id)) { seen.add(id); found.push([`Building ${id}`, rowOf(id), NONE]); }
      });
      parts.id.forEach((id, part) => { if (id.startsWith(words)) found.push([`Part ${id}`, parts.building[part], part]); });
    }
    const shown = found.slice(0, MOST_HITS).map(([text, row, part]) =>
      make("li", {}, make("button", { type: "button", text, on: () => { pick(row, part); goTo(row); } })));
    $("hits").replaceChildren(...shown);
    if (words) say(found.length ? `${found.length} found` : `Nothing has the id ${words}.`);
    else say("");
    return found;
  }

  // A building -----------------------------------------------------------------------------------------------------

  function pickAt(map, point, place) {
    const block = blockAt(map, point);
    if (block) pick(block.properties.row, chosen.scale > 0 ? block.properties.part : NONE);
    else nothingAt(place);
  }

  function pick(row, part = NONE) {
    chosen.picked = row;
    chosen.part = part;
    say("");
    if (row !== NONE && !isShown(row)) {
      chosen.view = buildings.first[row];
      if (chosen.other === chosen.view) chosen.other = NONE;
    }
    if (part !== NONE && chosen.scale < parts.scale[part]) chosen.scale = parts.scale[part];
    drawDetails();
    return draw();
  }

  function goTo(row) {
    const box = boundsOf(blocksOf()[row]), { map } = panes[0];
    const camera = { pitch: Math.min(map.getPitch(), 20), bearing: map.getBearing(), maxZoom: 18, duration: 600 };
    if (box) map.fitBounds(box, { ...camera, padding: Math.min(120, map.getContainer().clientWidth / 5) });
  }

  function valueOf(name, row, digits) {
    const value = buildings.values[name][row];
    if (value === null || value === "") return null;
    return typeof value === "number" ? (value / 10 ** digits).toFixed(Math.min(digits, 2)) : value;
  }

  function table(rows) {
    return make("table", {}, make("tbody", {}, ...rows.map(([words, value]) =>
      make("tr", {}, make("th", { scope: "row", text: words }), make("td", { text: value })))));
  }

  function drawDetails() {
    const row = chosen.picked;
    $("details").hidden = row === NONE;
    if (row === NONE) return;
    $("details-title").textContent = `Building ${buildings.id[row]}`;
    const facts = town.fields.map(([name, words, digits]) => [words, valueOf(name, row, digits)]).filter(([, value]) => value !== null);
    const every = make("details", {}, make("summary", { text: "All columns" }), table(facts));
    $("details-body").replaceChildren(table(summary(row)), ...support(row), ...tree(row), ...past(row), every);
  }

  // What most readers want to know first.
  function summary(row) {
    const digits = Object.fromEntries(town.fields.map(([name, , own]) => [name, own]));
    const value = (name) => (name in digits ? valueOf(name, row, digits[name]) : null);
    const length = (name, unit, places) => (value(name) === null ? null : `${Number(value(name)).toFixed(places)} ${unit}`);
    const [least, most] = [value("storeys_min"), value("storeys_max")];
    const range = least === null || most === null || least === most ? "" : ` (${least} to ${most})`;
    const years = value("valid_from") === null ? null : `${value("valid_from")} to ${value("valid_to") ?? "today"}`;
    return [["State", value("state")], ["Probability", value("probability")], ["Valid", years], ["Survey", value("survey")],
      ["Storeys", value("storeys") === null ? null : value("storeys") + range], ["Eaves", length("eaves", "m", 1)],
      ["Ridge", length("ridge", "m", 1)], ["Level of the ground", length("z_ground", "m", 1)], ["Footprint", length("area_m2", "m²", 0)],
      ["Imported", value("attributes")]].filter(([, own]) => own !== null);
  }

  function support(row) {
    const rows = town.detectors.map(([name, column]) => [name, buildings.shares[column][row]]);
    if (rows.every(([, share]) => share === null)) return [];
    const grid = make("div", { class: "support" });
    for (const [name, share] of rows) {
      const fill = make("span", { class: "fill" });
      fill.style.width = `${(share || 0) / 10}%`;
      const track = make("span", { class: "track" }, fill);
      grid.append(make("span", { text: name }), track, make("b", { text: share === null ? "not run" : `${Math.round(share / 10)} %` }));
    }
    return [make("h3", { text: "Covered by the regions of each detector" }), grid];
  }

  function tree(row) {
    const roots = partsOf()[row].filter((part) => parts.father[part] === NONE);
    if (!roots.length) return [make("p", { class: "note", text: "No parts are known." })];
    const branch = (some) => make("ul", { class: "tree" }, ...some.map((part) => {
      const words = `Scale ${parts.scale[part]}: ${parts.area[part].toLocaleString("en")} m², ${metres(parts.height[part])} high, `
        + `${parts.storeys[part]} ${parts.storeys[part] === 1 ? "storey" : "storeys"}`;
      const pressed = String(part === chosen.part);
      const item = make("li", {}, make("button", { type: "button", text: words, title: `Part ${parts.id[part]}`, "aria-pressed": pressed,
        on: () => pick(row, part === chosen.part ? NONE : part) }));
      if (childrenOf()[part].length) item.append(branch(childrenOf()[part]));
      return item;
    }));
    const count = partsOf()[row].length;
    return [make("h3", { text: `Tree of ${count} ${count === 1 ? "part" : "parts"}` }), branch(roots)];
  }

  function past(row) {
    if (!town.inventory) return [];
    const lines = versionsOf(row).map((own) => {
      const began = town.history.filter(([, , , after]) => after === own)
        .map(([view, kind]) => `${town.kinds[kind][0]} in ${views[view].name}`);
      const ended = town.history.filter(([, , before, after]) => before === own && after === NONE)
        .map(([view]) => `demolished in ${views[view].name}`);
      const days = `${valueOf("valid_from", own, 0)} to ${valueOf("valid_to", own, 0) ?? "today"}`;
      const words = [days, states[own], `mean height ${metres(buildings.height[own])}`, ...began, ...ended];
      return make("li", { text: words.join(", ") });
    });
    return [make("h3", { text: "History" }), make("ol", { class: "history" }, ...lines)];
  }

  // Where there is no building: the place, and the reason of the cell.
  async function nothingAt({ lng, lat }) {
    chosen.picked = chosen.part = NONE;
    const [east, north] = metresOf(lng, lat);
    const at = `${east.toFixed(1)}, ${north.toFixed(1)}`;
    const reason = town.reasons ? await reasonAt(lng, lat) : null;
    $("details-title").textContent = "No building here";
    $("details-body").replaceChildren(table([["Place", at], ["CRS", town.crs], ...(reason ? [["Reason", reason]] : [])]),
      make("p", { class: "note", text: `msbdb why DB --at ${at.replace(" ", "")} has what each detector decided.` }));
    $("details").hidden = false;
    draw();
  }

  let pixels = null;
  function reasonPixels() {
    pixels = pixels || new Promise((done, fail) => {
      const image = new Image();
      image.onload = () => {
        const canvas = make("canvas", { width: image.width, height: image.height });
        const context = canvas.getContext("2d", { willReadFrequently: true });
        context.drawImage(image, 0, 0);
        done(context);
      };
      image.onerror = fail;
      image.src = town.reasons.image;
    });
    return pixels;
  }

  async function reasonAt(lon, lat) {
    const [u, v] = shareOf(lon, lat);
    if (u < 0 || u >= 1 || v < 0 || v >= 1) return "outside of the surveys";
    const context = await reasonPixels();
    const { width, height } = context.canvas;
    const [red, green, blue, alpha] = context.getImageData(Math.floor(u * width), Math.floor(v * height), 1, 1).data;
    const colour = `#${[red, green, blue].map((value) => value.toString(16).padStart(2, "0")).join("")}`;
    const found = town.reasons.legend.find(([, own]) => (alpha ? own === colour : own === null));
    return found ? found[2] : null;
  }

  function closeDetails() {
    pick(NONE);
    panes[0].map.getCanvas().focus();
  }

  // Beginning ------------------------------------------------------------------------------------------------------

  function listen() {
    const number = (event) => Number(event.target.value);
    $("view").addEventListener("change", (event) => {
      chosen.view = number(event);
      if (chosen.view === NONE || chosen.other === chosen.view) chosen.other = NONE;
      draw();
    });
    $("other").addEventListener("change", (event) => {
      chosen.other = number(event);
      if (chosen.other !== NONE && town.inventory) chosen.colour = "change";
      draw();
    });
    $("colour").addEventListener("change", (event) => { chosen.colour = event.target.value; draw(); });
    $("scale").addEventListener("input", (event) => { chosen.scale = number(event); draw(); });
    $("query").addEventListener("input", search);
    $("search").addEventListener("submit", (event) => {
      event.preventDefault();
      const [first] = search();
      if (first) { pick(first[1], first[2]); goTo(first[1]); }
    });
    $("flat").addEventListener("click", () => {
      const isFlat = panes[0].map.getPitch() < 1;
      panes[0].map.easeTo({ pitch: isFlat ? 50 : 0, bearing: isFlat ? -20 : 0 });
      panes[0].map.once("moveend", drawControls);
    });
    $("home").addEventListener("click", () => showWhole(panes[0].map));
    $("theme").addEventListener("click", () => { chosen.dark = !chosen.dark; draw(); });
    $("close").addEventListener("click", closeDetails);
    $("fold").addEventListener("click", () => {
      const isOpen = $("fold").getAttribute("aria-expanded") === "true";
      $("fold").setAttribute("aria-expanded", String(!isOpen));
      $("fold").textContent = isOpen ? "+" : "−";
      $("controls").hidden = isOpen;
    });
    window.addEventListener("resize", fitPanes);
    document.addEventListener("keydown", (event) => {
      if (event.key === "Escape" && !$("details").hidden) { closeDetails(); return; }
      if (event.target.matches("input[type=search], select") || event.ctrlKey || event.metaKey || event.altKey) return;
      const step = { "[": -1, "]": 1 }[event.key];
      if (event.key === "/") { event.preventDefault(); $("query").focus(); }
      else if (step) {
        chosen.scale = Math.max(0, Math.min(finest, chosen.scale + step));
        draw();
        say(`Scale ${scaleWords(chosen.scale)}`);
      }
    });
  }

  function begin() {
    const camera = readAddress();
    document.documentElement.dataset.theme = chosen.dark ? "dark" : "light";
    $("title").textContent = town.title;
    $("subtitle").textContent = town.subtitle;
    if (!document.createElement("canvas").getContext("webgl2")) {
      $("controls").hidden = true;
      say("This browser has no WebGL 2, without which the map cannot be drawn.");
      return;
    }
    maplibregl.addProtocol("slopes", groundTile);
    if (isTiled) openTiles();
    makeLayers();
    listen();
    if (window.innerWidth <= 700) $("fold").click();
    document.body.classList.toggle("two", chosen.other !== NONE);
    $("pane-b").hidden = chosen.other === NONE;
    if (chosen.other === NONE) addPane(camera, chosen.view, NONE);
    else addPane(camera, pair()[0], 0);
    if (chosen.picked !== NONE) drawDetails();
    draw();
    // For tests and the curious: how long it took until the town could be seen and used, milliseconds.
    const seen = panes.map(({ map }) => new Promise((done) => map.once("idle", done)));
    Promise.all([drawing, ...seen]).then(() => { document.documentElement.dataset.ready = Math.round(performance.now()); });
  }

  begin();
})();
