"use strict";
(() => {
  const USUAL = [
    "goes through another object", "leaves the road", "moves as no car can",
    "gives the ego no way out", "pictures are broken", "challenges nobody",
  ];
  const MARKS = { accepted: "✓", rejected: "✗" };
  const STEP_MS = 500;
  const at = (id) => document.getElementById(id);
  let state = null, here = 0, scene = null, place = 0, timer = null, asked = 0;

  async function ask(path, body) {
    const options = body === undefined ? {} : {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body),
    };
    const answer = await fetch(path, options);
    const value = await answer.json();
    if (!answer.ok) { throw new Error(value.error); }
    return value;
  }

  function say(text) { at("said").textContent = text; }

  function drawList() {
    const list = at("scenes");
    list.replaceChildren(...state.scenes.map((row, index) => {
      const button = document.createElement("button");
      const mark = document.createElement("span");
      const name = document.createElement("span");
      mark.textContent = MARKS[row.verdict] || "·";
      mark.className = row.verdict || "";
      name.textContent = row.name;
      button.type = "button";
      button.append(mark, name);
      button.setAttribute("aria-current", String(index === here));
      button.setAttribute("aria-label", `${row.name}, ${row.verdict || "not reviewed"}`);
      button.addEventListener("click", () => show(index));
      const item = document.createElement("li");
      item.append(button);
      return item;
    }));
    list.children[here].scrollIntoView({ block: "nearest" });
    const count = (verdict) => state.scenes.filter((row) => row.verdict === verdict).length;
    at("progress").textContent =
      `${count("accepted")} accepted, ${count("rejected")} rejected, ${count(null)} not reviewed`;
    at("data").textContent = `${state.data}: ${state.root}`;
    const row = state.scenes[here];
    at("verdict").textContent = row.verdict || "not reviewed";
    at("verdict").className = row.verdict || "";
  }

  function drawPictures() {
    at("slider").value = String(place);
    at("clock").textContent = `${scene.seconds[place].toFixed(1)} of ${scene.seconds.at(-1).toFixed(1)} s`;
    at("above").src = `picture/${here}/${place}/above.png`;
    if (!scene.cameras.length) { return; }
    at("cameras").src = `picture/${here}/${place}/cameras.webp`;
    const edges = at("edges");
    edges.setAttribute("viewBox", `0 0 ${scene.width} ${scene.height}`);
    const shown = at("boxes").checked ? scene.edges[place] : [];
    edges.replaceChildren(...shown.map((ends) => {
      const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
      ["x1", "y1", "x2", "y2"].forEach((name, index) => line.setAttribute(name, String(ends[index])));
      return line;
    }));
  }

  function drawLabels() {
    at("pictures").classList.toggle("blind", !scene.cameras.length);
    at("cameras-figure").hidden = !scene.cameras.length;
    at("labels").replaceChildren(...scene.cameras.map((cell) => {
      const label = document.createElement("span");
      label.textContent = cell.name;
      label.style.setProperty("left", `${100 * cell.left / scene.width}%`);
      label.style.setProperty("top", `${100 * cell.top / scene.height}%`);
      return label;
    }));
  }

  async function show(index) {
    stop();
    asked += 1;
    const mine = asked;
    here = Math.min(Math.max(index, 0), state.scenes.length - 1);
    const row = state.scenes[here];
    at("name").textContent = row.name;
    at("reason").value = row.reason;
    at("about").textContent = "";
    say("");
    drawList();
    try {
      const found = await ask(`scene/${here}`);
      if (mine !== asked) { return; }
      scene = found;
    } catch (error) { say(error.message); return; }
    const words = [`from ${row.source}`, row.manoeuvre, scene.description].filter(Boolean);
    at("about").textContent = `${here + 1} of ${state.scenes.length}: ${words.join(" · ")}`;
    at("slider").max = String(scene.seconds.length - 1);
    place = 0;
    drawLabels();
    drawPictures();
    window.CHALLENGER_READY = true;
  }

  function stop() { window.clearInterval(timer); timer = null; at("play").textContent = "Play"; }

  function play() {
    if (timer !== null) { stop(); return; }
    if (place === scene.seconds.length - 1) { place = -1; }
    timer = window.setInterval(() => {
      if (place === scene.seconds.length - 1) { stop(); return; }
      step(1);
    }, STEP_MS);
    at("play").textContent = "Stop";
  }

  function step(by) { place = Math.min(Math.max(place + by, 0), scene.seconds.length - 1); drawPictures(); }

  async function judge(verdict) {
    const reason = at("reason").value.trim();
    if (verdict === "rejected" && !reason) {
      at("reason").focus();
      say("Say why, then press Enter.");
      return;
    }
    try {
      state = await ask("verdict", { scene: here, verdict, reason: verdict === null ? "" : reason });
    } catch (error) { say(error.message); return; }
    at("reason").blur();
    if (verdict !== null && here < state.scenes.length - 1) { await show(here + 1); } else { await show(here); }
  }

  function nextWaiting() {
    const order = [...state.scenes.keys()].map((offset) => (here + 1 + offset) % state.scenes.length);
    const waiting = order.find((index) => state.scenes[index].verdict === null);
    if (waiting === undefined) { say("Every scene has a verdict."); } else { show(waiting); }
  }

  async function finish() {
    try { await ask("done", {}); } catch (error) { say(error.message); return; }
    stop();
    at("over").hidden = false;
  }

  const KEYS = {
    a: () => judge("accepted"), r: () => judge("rejected"), u: () => judge(null),
    n: () => show(here + 1), p: () => show(here - 1), j: nextWaiting, " ": play,
    ArrowLeft: () => { stop(); step(-1); }, ArrowRight: () => { stop(); step(1); },
    b: () => { at("boxes").checked = !at("boxes").checked; drawPictures(); },
  };
  USUAL.forEach((text, index) => { KEYS[String(index + 1)] = () => { at("reason").value = text; }; });

  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || state === null) { return; }
    if (event.target === at("reason")) {
      if (event.key === "Escape") { at("reason").blur(); }
      if (event.key === "Enter") { event.preventDefault(); judge("rejected"); }
      return;
    }
    const pressed = event.key === " " && event.target.tagName === "BUTTON" ? undefined : KEYS[event.key];
    if (pressed && scene !== null) { event.preventDefault(); pressed(); }
  });
  at("form").addEventListener("submit", (event) => event.preventDefault());
  at("slider").addEventListener("input", () => { stop(); place = Number(at("slider").value); drawPictures(); });
  at("boxes").addEventListener("change", drawPictures);
  at("play").addEventListener("click", play);
  at("accept").addEventListener("click", () => judge("accepted"));
  at("reject").addEventListener("click", () => judge("rejected"));
  at("clear").addEventListener("click", () => judge(null));
  at("next").addEventListener("click", () => show(here + 1));
  at("previous").addEventListener("click", () => show(here - 1));
  at("finish").addEventListener("click", finish);
  at("usual").replaceChildren(...USUAL.map((text, index) => {
    const button = document.createElement("button");
    const key = document.createElement("kbd");
    key.textContent = String(index + 1);
    button.type = "button";
    button.append(key, ` ${text}`);
    button.addEventListener("click", () => { at("reason").value = text; });
    return button;
  }));
  (async () => {
    try { state = await ask("state"); } catch (error) { say(error.message); return; }
    const waiting = state.scenes.findIndex((row) => row.verdict === null);
    await show(waiting < 0 ? 0 : waiting);
  })();
})();
