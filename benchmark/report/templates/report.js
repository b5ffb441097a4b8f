"use strict";
(() => {
  const facts = JSON.parse(document.getElementById("facts").textContent);
  const pictures = JSON.parse(document.getElementById("pictures").textContent);
  const find = (selector, within = document) => within.querySelector(selector);
  const all = (selector, within = document) => [...within.querySelectorAll(selector)];
  const controls = { track: find("#track"), fit: find("#fit"), a: find("#a"), b: find("#b") };
  const models = facts.models;

  const element = (tag, name, text) => {
    const made = document.createElement(tag);
    if (name) made.className = name;
    if (text !== undefined) made.textContent = text;
    return made;
  };

  const panel = () =>
    find(`[data-track="${CSS.escape(controls.track.value)}"][data-fit="${CSS.escape(controls.fit.value)}"]`);

  // Disable options that this track does not have.
  const offer = () => {
    const fits = all(`[data-track="${CSS.escape(controls.track.value)}"]`).map((part) => part.dataset.fit);
    for (const option of controls.fit.options) option.disabled = !fits.includes(option.value);
    if (!fits.includes(controls.fit.value)) controls.fit.value = fits[0];
    const there = panel().dataset.models.split(" ");
    for (const select of [controls.a, controls.b]) {
      for (const option of select.options) option.disabled = !there.includes(option.value);
    }
    const [first, second] = panel().dataset.first.split(" ");
    if (!there.includes(controls.a.value)) controls.a.value = first;
    if (!there.includes(controls.b.value)) controls.b.value = controls.a.value === second ? first : second;
  };

  const mark = () => {
    const rule = (model, letter) =>
      `[data-m="${model}"]{--mark:var(--${letter});--stroke:2.5;--show:1;--weight:700}`;
    find("#marks").textContent = rule(controls.b.value, "b") + rule(controls.a.value, "a");
    for (const letter of ["b", "a"]) {
      for (const curve of all(`svg [data-m="${controls[letter].value}"]`, panel())) curve.parentNode.append(curve);
      for (const key of all(`.key.${letter}`)) key.textContent = models[controls[letter].value];
    }
  };

  const tile = (name, letter, picture, photo) => {
    const made = element("div", `tile ${letter}`, name);
    const image = element("img", photo ? "photo" : "");
    image.alt = name;
    image.src = pictures[picture];
    made.prepend(image);
    return made;
  };

  const drawCard = (card) => {
    const made = element("div", "card");
    const tiles = element("div", "tiles");
    tiles.append(tile("image", "", card.rgb, true), tile("truth", "", card.truth, false));
    const said = element("p", "said", `Scene ${card.scene}, ${card.where}`);
    const isFirst = ([model]) => Number(String(model) !== controls.a.value);
    for (const [model, picture, score, words] of [...card.maps].sort((x, y) => isFirst(x) - isFirst(y))) {
      const letter = String(model) === controls.a.value ? "a" : "b";
      tiles.append(tile(models[model], letter, picture, false));
      said.append(element("br"), element("span", letter, models[model]), ` ${score}: ${words}`);
    }
    made.append(tiles, said);
    return made;
  };

  const fill = (place, cards, otherwise) => {
    place.replaceChildren(...(cards && cards.length ? cards.map(drawCard) : [element("p", "note", otherwise)]));
  };

  const drawGallery = (gallery) => {
    const [a, b] = [Number(controls.a.value), Number(controls.b.value)];
    fill(find(".worst", panel()), gallery.worst[a], "There are no label maps of this model here.");
    const reason = a === b ? "Choose two different models." : "The report has no pictures of this pair.";
    fill(find(".apart", panel()), gallery.pairs[`${Math.min(a, b)},${Math.max(a, b)}`], reason);
  };

  const signed = (value, digits) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;
  // Print enough digits that a difference from 0 is visible.
  const digitsFor = (values) => [3, 4, 5].find((digits) => values.every((v) => !v || Number(v.toFixed(digits)))) || 6;

  const compare = () => {
    const [a, b] = [controls.a.value, controls.b.value];
    const known = facts.comparisons[panel().dataset.gallery];
    const [found, sign] = known[`${a},${b}`] ? [known[`${a},${b}`], 1] : [known[`${b},${a}`], -1];
    if (!found) return "";
    const [mean, low, high, wins, resolvable, scenes] = found;
    const [from, to] = sign > 0 ? [low, high] : [-high, -low];
    const share = sign > 0 ? wins : 1 - wins;
    const holdsZero = from <= 0 && to >= 0;
    const digits = holdsZero ? 3 : digitsFor([mean, from, to]);
    const better = holdsZero ? " The interval contains 0." : "";
    const [shown, start, end] = [sign * mean, from, to].map((value) => signed(value, digits));
    return `${models[a]} minus ${models[b]}, MSC-FG: ${shown} [${start}, ${end}], paired over ${scenes} scenes; it wins ` +
      `${Math.round(100 * share)}% of them.${better} The smallest detectable difference is about ${resolvable.toFixed(3)}.`;
  };

  // A clip is a strip of images; CSS moves the strip behind a window of one image.
  const drawClip = (clip, layer, caption, letter) => {
    const made = element("figure", `clip ${letter || ""}`);
    const frame = element("div", "window");
    frame.style.setProperty("--ratio", clip.ratio);
    const image = element("img", layer.photo ? "photo" : "");
    image.alt = `${caption}, scene ${clip.scene}`;
    image.addEventListener("load", () => {
      const gap = 2, width = (image.naturalWidth + gap) / clip.count - gap;
      image.style.setProperty("--count", clip.count);
      image.style.setProperty("--scale", image.naturalWidth / width);
      image.style.setProperty("--shift", `${(-100 * clip.count * (width + gap)) / image.naturalWidth}%`);
    });
    image.src = pictures[layer.picture];
    frame.append(image);
    made.append(frame);
    return made;
  };

  const nameOf = (layer) => layer.name || `${models[layer.model]}${layer.part ? `, ${layer.part}` : ""}`;
  const letterOf = (layer) =>
    ["a", "b"].find((letter) => layer.model !== undefined && String(layer.model) === controls[letter].value);

  // The strip beside the leaderboard: RGB, ground truth and the two chosen models; a column for each scene.
  const drawPreview = (gallery) => {
    const clips = gallery.clips;
    const place = find(".preview", panel());
    const rows = clips.length ? clips[0].layers : [];
    const chosen = (letter) => rows.map((row, index) => index).filter((index) => letterOf(rows[index]) === letter);
    const shown = [...new Set([0, 1, ...chosen("a"), ...chosen("b")])];
    const grid = element("div", "previews");
    grid.style.setProperty("--scenes", clips.length);
    grid.style.setProperty("--rows", shown.length);
    grid.append(element("span"), ...clips.map((clip) => element("span", "said", `Scene ${clip.scene}`)));
    for (const index of shown) {
      const letter = letterOf(rows[index]);
      grid.append(element("span", `label ${letter || ""}`, rows[index].part || nameOf(rows[index])));
      for (const clip of clips) {
        const made = drawClip(clip, clip.layers[index], nameOf(rows[index]), letter);
        if (clip.layers[index].score && !rows[index].part) made.append(element("figcaption", "", clip.layers[index].score));
        grid.append(made);
      }
    }
    place.replaceChildren(grid, element("p", "note", `${gallery.choice} Numbers: MSC-FG on the scene.`));
  };

  const drawClips = (gallery) => {
    const parts = gallery.clips.map((clip) => {
      const made = element("div", "tilesheet");
      for (const layer of clip.layers) {
        const letter = letterOf(layer);
        const tile = drawClip(clip, layer, nameOf(layer), letter);
        const caption = element("figcaption", letter || "", nameOf(layer));
        if (layer.score && !layer.part) caption.append(element("small", "", ` ${layer.score}`));
        tile.append(caption);
        made.append(tile);
      }
      for (const [model, reason] of Object.entries(gallery.crashed)) {
        made.append(element("p", "empty failed", `${models[model]}: ${reason}`));
      }
      return [element("h3", "", `Scene ${clip.scene}`), made];
    });
    find(".clips", panel()).replaceChildren(...parts.flat());
  };

  const drawPictures = () => {
    const gallery = facts.galleries[panel().dataset.gallery];
    if (!gallery) return;
    drawPreview(gallery);
    drawClips(gallery);
    drawGallery(gallery);
  };

  const play = find("#play");
  const setPlaying = (playing) => {
    document.body.classList.toggle("paused", !playing);
    play.setAttribute("aria-pressed", String(playing));
    play.textContent = playing ? "Pause clips" : "Play clips";
  };

  const show = () => {
    offer();
    for (const part of all("[data-track]")) {
      part.hidden = part !== panel();
      for (const heading of all("[data-id]", part)) heading.id = part.hidden ? "" : heading.dataset.id;
    }
    mark();
    find(".versus", panel()).textContent = compare();
    drawPictures();
  };

  const remember = () => {
    const state = new URLSearchParams();
    for (const [name, select] of Object.entries(controls)) {
      state.set(name, name.length === 1 ? models[select.value] : select.value);
    }
    history.replaceState(null, "", `#${state}`);
  };

  const recall = () => {
    const state = new URLSearchParams(location.hash.slice(1));
    for (const [name, select] of Object.entries(controls)) {
      const wanted = name.length === 1 ? String(models.indexOf(state.get(name))) : state.get(name);
      if ([...select.options].some((option) => option.value === wanted)) select.value = wanted;
    }
  };

  for (const select of Object.values(controls)) {
    select.addEventListener("change", () => { show(); remember(); });
  }
  play.addEventListener("click", () => setPlaying(document.body.classList.contains("paused")));
  window.addEventListener("hashchange", () => { recall(); show(); });
  recall();
  show();
  setPlaying(!window.matchMedia("(prefers-reduced-motion: reduce)").matches);
})();
