// What the bench page does in the browser by itself: tones and vibration, silence that is noticed.
window.highside = (() => {
  const TONES = {  // frequency in Hz, begin and length in s
    "hands-off": [[880, 0, 0.16]],
    done: [[660, 0, 0.12], [990, 0.14, 0.24]],
    all: [[660, 0, 0.12], [990, 0.14, 0.12], [1320, 0.28, 0.4]],
    knock: [[196, 0, 0.18], [196, 0.26, 0.28]],
    "no-data": [[330, 0, 0.3], [247, 0.34, 0.5]],
  };
  const SHAKES = { "hands-off": [60], done: [60, 80, 60], all: [60, 80, 60, 80, 200], knock: [250, 80, 250], "no-data": [500] };
  const KEPT = "highside-sound";
  const SILENT_MS = 3000;  // a page that hears nothing for so long says so; the server speaks each second
  let context = null, heard = performance.now();

  const wanted = () => { try { return localStorage.getItem(KEPT) === "on"; } catch { return false; } };
  const keep = (on) => { try { localStorage.setItem(KEPT, on ? "on" : "off"); } catch { /* a private window */ } };

  // a browser lets a page sound only after its reader has touched it
  function wake() {
    if (!wanted()) return;
    context ??= new AudioContext();
    if (context.state === "suspended") context.resume();
  }

  function show() {
    for (const button of document.querySelectorAll(".sound")) {
      button.textContent = wanted() ? button.dataset.on : button.dataset.off;
      button.setAttribute("aria-pressed", wanted());
    }
  }

  function cue(name) {
    if (!wanted() || !TONES[name]) return;
    navigator.vibrate?.(SHAKES[name]);
    if (context?.state !== "running") return;
    for (const [frequency, begin, length] of TONES[name]) {
      const at = context.currentTime + begin, tone = context.createOscillator(), volume = context.createGain();
      tone.type = "triangle";
      tone.frequency.value = frequency;
      // swells and fades within 10 ms: a hard edge is a click
      volume.gain.setValueAtTime(0, at);
      volume.gain.linearRampToValueAtTime(0.5, at + 0.01);
      volume.gain.setValueAtTime(0.5, at + length - 0.01);
      volume.gain.linearRampToValueAtTime(0, at + length);
      tone.connect(volume).connect(context.destination);
      tone.start(at);
      tone.stop(at + length);
    }
  }

  function beat() {
    heard = performance.now();
    document.body.classList.remove("lost");
  }

  for (const kind of ["pointerdown", "keydown"]) document.addEventListener(kind, wake, true);
  document.addEventListener("click", (event) => {
    if (!event.target.closest?.(".sound")) return;
    keep(!wanted());
    if (!wanted()) navigator.vibrate?.(0);
    wake();
    show();
    cue("hands-off");
  });
  // one that is larger than is taken is made smaller here, as the server would make it; null where that is beyond the
  // browser. The right way up: a camera that was turned says so in the file, and the smaller one has no such word
  async function smaller(file, side) {
    try {
      const whole = await createImageBitmap(file), scale = Math.min(1, side / Math.max(whole.width, whole.height));
      const drawn = document.createElement("canvas");
      drawn.width = Math.round(scale * whole.width);
      drawn.height = Math.round(scale * whole.height);
      drawn.getContext("2d").drawImage(whole, 0, 0, drawn.width, drawn.height);
      whole.close();
      return await new Promise((done) => drawn.toBlob(done, "image/jpeg", 0.92));
    } catch {
      return null;
    }
  }

  // a photograph goes as it is; the server says what became of it
  document.addEventListener("submit", async (event) => {
    const form = event.target.closest?.("form.photograph");
    if (!form) return;
    event.preventDefault();
    const [file, text] = form.querySelectorAll("input"), button = form.querySelector("button");
    const answer = form.querySelector("[role=status]"), said = new URLSearchParams({ operator: form.dataset.operator, text: text.value });
    answer.textContent = button.dataset.sending;
    button.disabled = true;
    try {
      const most = 1e6 * Number(form.dataset.most), sent = file.files[0];
      const body = sent.size > most ? await smaller(sent, Number(form.dataset.side)) : sent;
      if (!body) throw new RangeError(form.dataset.large);
      const got = await fetch(`/photograph?${said}`, { method: "POST", body });
      answer.textContent = await got.text();
      if (got.ok) form.reset();
    } catch (error) {
      answer.textContent = error instanceof RangeError ? error.message : button.dataset.failed;
    }
    button.disabled = false;
  });
  // the session goes on whatever the page does; what is half written in a dialog would be gone: the browser asks first
  addEventListener("beforeunload", (event) => {
    const fields = document.querySelectorAll("[aria-modal=true] :is(textarea, input:not([type=file]))");
    if ([...fields].some((one) => one.value.trim())) event.preventDefault();
  });
  setInterval(() => { if (performance.now() - heard > SILENT_MS) document.body.classList.add("lost"); }, 500);
  // What is clicked while the link is cut would be kept by the socket, and command the session whenever it is back
  const COMMANDS = ".command, .redo-one, .q-menu";
  const away = () => document.body.classList.contains("lost");
  for (const kind of ["click", "keydown"]) window.addEventListener(kind, (event) => {
    if (!away() || event.key === "Tab" || event.target.matches?.("input, textarea")) return;
    if (kind === "click" && !event.target.closest?.(COMMANDS)) return;
    event.stopImmediatePropagation();
    if (kind === "click" || event.target.closest?.(COMMANDS)) event.preventDefault();
  }, true);
  // What is behind an open dialog is inert: no key, click or screen reader gets there. A dialog comes as a child of
  // the body of its own, and is modal while it is shown; who closes it is where he was before.
  const behind = () => document.getElementById("app");
  let left = null;

  function shield() {
    const app = behind(), open = document.querySelector("[aria-modal=true]") !== null;
    if (!app || app.inert === open) return;
    app.inert = open;
    if (!open && !app.contains(document.activeElement)) left?.focus();
  }

  const shown = new MutationObserver(shield);
  document.addEventListener("focusin", (event) => { if (behind()?.contains(event.target)) left = event.target; });
  const portals = new MutationObserver((changes) => {
    for (const change of changes) for (const node of change.addedNodes)
      if (node.nodeType === Node.ELEMENT_NODE)
        shown.observe(node, { attributes: true, subtree: true, childList: true, attributeFilter: ["aria-modal"] });
    shield();
  });
  const watch = () => portals.observe(document.body, { childList: true });
  if (document.body) watch(); else document.addEventListener("DOMContentLoaded", watch);

  return { cue, beat, show };
})();
