// A form is sent once the server has answered that it is there and still knows who sends: otherwise what was written
// stays where it is, and why nothing was sent is told. A file is sent from the page, which stays until it has arrived.
// What was sent is remembered by this tab until a page of ours has answered: whoever comes back from none finds it again.
(() => {
  "use strict";
  const WAITED_MS = 5000; // a cable that was pulled answers nothing at all
  const UPLOAD_MS = 300000; // as the server
  const AGAIN_MS = 1500; // a second click on the way to the next page
  const SENT = "highside-sent";
  const busy = new WeakSet(), changed = new Set();
  let checked = null; // the form whose sending was found to be possible

  function tell(form, name, text, field) {
    for (const line of document.querySelectorAll("[data-told]")) line.remove();
    for (const marked of document.querySelectorAll("[aria-invalid]")) {
      marked.removeAttribute("aria-invalid");
      marked.removeAttribute("aria-describedby");
    }
    const found = name && document.querySelector(`template[data-unsent=${name}]`);
    if (!found) return;
    const line = found.content.firstElementChild.cloneNode(true), words = line.querySelector("span");
    if (text) words.textContent = text;
    line.dataset.told = name;
    if (field) {
      words.textContent = words.textContent.replace("{count}", field.count).replace("{most}", field.most);
      line.id = `${field.at.id}-told`;
      field.at.setAttribute("aria-invalid", "true");
      field.at.setAttribute("aria-describedby", line.id);
      // before the field, whose end may be far down the page
      field.at.before(line);
      field.at.focus({ preventScroll: true });
    } else form.append(line);
    line.scrollIntoView({ block: "nearest" });
  }

  // letters as the server counts them, which takes no more of a field than it says
  function tooLong(form) {
    for (const at of form.querySelectorAll("[data-longest]")) {
      let count = 0;
      for (const _letter of at.value) count += 1;
      if (count > Number(at.dataset.longest)) return { at, count, most: at.dataset.longest };
    }
    return null;
  }

  const written = (form) => [...form.elements].filter((one) => one.name && !["password", "file"].includes(one.type));

  function remember(form) {
    const fields = written(form).filter((one) => one.type !== "submit").map((one) => [one.name, one.value, one.checked]);
    const place = [...document.forms].indexOf(form), who = document.body.dataset.who;
    try {
      sessionStorage.setItem(SENT, JSON.stringify({ path: location.pathname, who, place, action: form.action, fields }));
    } catch { /* no room, or a private window */ }
  }

  function find() {
    let sent = null;
    try {
      sent = JSON.parse(sessionStorage.getItem(SENT));
      sessionStorage.removeItem(SENT);
    } catch { /* none */ }
    const at = new URL(location), sentBack = at.searchParams.has("kept");
    at.searchParams.delete("kept");
    if (sentBack) history.replaceState(null, "", at);
    const came = performance.getEntriesByType("navigation")[0]?.type;
    if (!sent || (!sentBack && came !== "back_forward")) return;
    const form = document.forms[sent.place];
    if (sent.path !== location.pathname || sent.who !== document.body.dataset.who || form?.action !== sent.action) return;
    let stands = true;
    for (const [name, value, checked] of sent.fields) {
      const at = written(form).find((one) => one.name === name && (one.type !== "radio" || one.value === value));
      if (!at) continue;
      if (at.type !== "hidden" && (at.value !== value || at.checked !== checked)) stands = false;
      if (["checkbox", "radio"].includes(at.type)) at.checked = checked;
      else at.value = value;
    }
    if (stands) return;
    changed.add(form);
    tell(form, "kept");
  }

  async function hindrance() {
    try {
      const answer = await fetch("/here", { cache: "no-store", signal: AbortSignal.timeout(WAITED_MS) });
      const here = await answer.json(), who = document.body.dataset.who;
      return !who || here.who === who ? "" : "gone";
    } catch {
      return "lost";
    }
  }

  async function upload(form) {
    const most = 1e6 * Number(form.dataset.most);
    if ([...form.querySelectorAll("[type=file]")].some((one) => one.files[0]?.size > most)) return ["large"];
    const end = new AbortController(), timer = setTimeout(() => end.abort(), UPLOAD_MS), cut = () => end.abort();
    addEventListener("offline", cut);
    try {
      const answer = await fetch(form.action, { method: "POST", body: new FormData(form), signal: end.signal });
      const page = await answer.text();
      if (answer.redirected) {
        changed.delete(form);
        location.assign(answer.url);
        return [""];
      }
      const said = new DOMParser().parseFromString(page, "text/html");
      return ["refused", (said.querySelector(".alarm > span") ?? said.body).textContent.trim()];
    } catch {
      return ["cut"];
    } finally {
      clearTimeout(timer);
      removeEventListener("offline", cut);
    }
  }

  async function send(form, submitter) {
    const long = tooLong(form);
    if (long) {
      tell(form, "long", "", long);
      return busy.delete(form);
    }
    const why = await hindrance();
    tell(form, why);
    if (!why && form.dataset.most) tell(form, ...(await upload(form)));
    if (why || form.dataset.most) return busy.delete(form);
    changed.delete(form);
    remember(form);
    checked = form;
    form.requestSubmit(submitter);
    setTimeout(() => busy.delete(form), AGAIN_MS);
  }

  document.addEventListener("submit", (event) => {
    const form = event.target;
    if (checked === form) {
      checked = null;
      return;
    }
    event.preventDefault();
    if (busy.has(form)) return;
    busy.add(form);
    send(form, event.submitter);
  });

  // a language, another page or a step back would take what was written away: the browser asks first
  document.addEventListener("input", (event) => {
    const form = event.target.form;
    if (form?.matches(".form") && event.target.type !== "password") changed.add(form);
  });
  addEventListener("beforeunload", (event) => {
    if (changed.size) event.preventDefault();
  });
  // a browser may put something back by itself, at the latest when the page is shown
  addEventListener("pageshow", (event) => event.persisted || find());
})();
