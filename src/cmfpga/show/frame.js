"use strict";
/* What all pages share: their data, and the controls that choose which one of many they show. */

const $ = (id) => document.getElementById(id);
const head = JSON.parse($("head").textContent);
let page, preferred; // what `begin` was given; the theme (`root` and `dark` are the page's)
let shown = 0; // which one
let playing = null;
let drawing = false;

/* Dark or light: as chosen, or else as the system is. */
function theme(now = preferred ?? (dark.matches ? "dark" : "light")) {
  root.dataset.theme = now;
  page.drawAll();
}

/* Draw once per picture of the screen, however fast the slider moves. */
function go(index) {
  shown = Math.max(0, Math.min(page.count - 1, index));
  $("slider").value = shown;
  page.tell();
  $("slider").setAttribute("aria-valuetext", $("where").textContent);
  if (drawing) return;
  drawing = true;
  requestAnimationFrame(() => { drawing = false; page.draw(); });
}

function play() {
  if (playing) { clearInterval(playing); playing = null; } else {
    if (shown === page.count - 1) go(0);
    playing = setInterval(() => (shown === page.count - 1 ? play() : go(shown + 1)), 350);
  }
  $("play").textContent = playing ? "❚❚ stop" : "▶ play";
}

function listen() {
  const slider = $("slider");
  slider.max = page.count - 1;
  slider.addEventListener("input", () => go(Number(slider.value)));
  $("previous").addEventListener("click", () => go(shown - 1));
  $("next").addEventListener("click", () => go(shown + 1));
  $("play").addEventListener("click", play);
  const steps = { ArrowLeft: -1, ArrowRight: 1, PageUp: 10, PageDown: -10, Home: -Infinity, End: Infinity };
  document.addEventListener("keydown", (event) => {
    const step = steps[event.key];
    if (step === undefined || event.ctrlKey || event.altKey || event.metaKey) return;
    const inside = event.target.closest?.("input[type=radio], .scroll");
    // Away from the slider, the keys that scroll the page go on doing so.
    if (inside || (event.target !== slider && !event.key.startsWith("Arrow"))) return;
    event.preventDefault();
    go(shown + step);
  });
  $("theme").addEventListener("click", () => theme(preferred = root.dataset.theme === "dark" ? "light" : "dark"));
  dark.addEventListener("change", () => theme());
  window.addEventListener("beforeprint", () => theme("light")); // paper is white
  window.addEventListener("afterprint", () => theme());
}

/* Show one of `count`. `unpack` takes the data, an ArrayBuffer; `tell` says at once what is shown, `draw` draws it, and
   `drawAll` all that has colours of the theme; `listen` adds controls. */
async function begin(made) {
  page = { listen() {}, ...made };
  try {
    const packed = Uint8Array.from(atob($("blob").textContent), (sign) => sign.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    page.unpack(await new Response(stream).arrayBuffer());
    page.tell();
    page.drawAll();
    listen();
    page.listen();
    document.body.dataset.ready = "yes";
  } catch (error) {
    $("problem").textContent = `This browser cannot draw the page: ${error.message}`;
    $("problem").hidden = false;
    throw error;
  }
}
