// STOP, the keys and buttons that are held, and signs of life, over the page's own websocket (control_channel.py).
const EVERY = 100, SILENT = 700, UNCONFIRMED = 500, OLD = 0.5;  // [ms], [ms], [ms], [s]
const BUTTON = "Use the robot's own red button.";
const keys = new Set(), fingers = new Map();  // what is held: on the keyboard, and by each pointer
let socket, tried = 0, heard = performance.now(), unanswered = 0, age = 0;
let pressed = 0, sent = 0, failed = '';  // STOP: since when it is unconfirmed, when it was sent last, what went wrong

const button = document.createElement('button'), banner = document.createElement('div');
button.id = 'longreach-stop';
button.type = 'button';
button.title = 'Brake at once and stay so';
button.append('STOP', document.createElement('small'));
banner.id = 'longreach-banner';
banner.setAttribute('role', 'alert');
banner.append(document.createElement('b'), document.createElement('span'));
document.body.append(banner, button);

function connect() {
  if (socket) { socket.onclose = socket.onmessage = null; socket.close(); }
  tried = performance.now();
  socket = new WebSocket(`ws://${location.host}/${location.pathname.split('/')[1]}/control`);
  socket.onmessage = ({ data }) => {
    const answer = JSON.parse(data);
    heard = performance.now();
    unanswered = 0;
    if ('age' in answer) age = answer.age;
    else if (answer.stopped) { pressed = 0; failed = ''; }
    else failed = answer.why;
    show();
  };
  socket.onclose = () => { heard = -Infinity; unanswered = Infinity; show(); };
}
const send = message => { if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message)); };
const tell = () => send({ held: [...new Set([...keys, ...fingers.values()])].join('') });
const release = () => { if (keys.size || fingers.size) { keys.clear(); fingers.clear(); tell(); } };

function stop() {
  keys.clear();
  fingers.clear();
  pressed ||= performance.now();
  sent = performance.now();
  send({ stop: true });
}

function trouble() {
  const now = performance.now(), silent = now - heard;
  // A page that was busy has not asked meanwhile: what counts are questions without an answer.
  if (silent > SILENT && unanswered >= 5)
    return ['The view does not answer.', `STOP from here cannot reach the robot. ${BUTTON}`];
  if (pressed && failed) return ['STOP has failed.', `${failed} It is sent again and again. ${BUTTON}`];
  if (pressed && now - pressed > UNCONFIRMED)
    return ['The robot has not confirmed STOP.', `It is sent again and again. ${BUTTON}`];
  if (age > OLD)
    return [`The robot has been silent for ${age.toFixed(1)} s.`, `STOP from here may not reach it. ${BUTTON}`];
  return null;
}

function show() {
  const now = trouble();
  button.classList.toggle('longreach-off', !!now);
  button.lastChild.textContent = now ? 'no contact' : 'space bar';
  banner.style.display = now ? 'block' : 'none';
  if (now) [banner.firstChild.textContent, banner.lastChild.textContent] = now;
}

// A touch counts when it begins; a click may come from the keyboard, or from what helps people to use a page.
button.addEventListener('pointerdown', stop);
button.addEventListener('click', stop);

// On window and capturing: before any element of the page that has the focus, and whatever it does with its keys.
const isSpace = e => e.code === 'Space' || e.key === ' ';
const swallow = e => { e.preventDefault(); e.stopImmediatePropagation(); };
window.addEventListener('keydown', e => {
  if (isSpace(e)) {
    swallow(e);
    if (!e.repeat) stop();
    return;
  }
  if (e.ctrlKey || e.metaKey || e.altKey) return release();  // then some systems do not say that a key is released
  const key = /^Key([IJKLUO])$/.exec(e.code)?.[1];
  if (!key || e.repeat || e.target.closest?.('input, textarea, select')) return;
  keys.add(key);
  tell();
}, true);
window.addEventListener('keyup', e => {
  if (isSpace(e)) return swallow(e);
  if (keys.delete(e.code?.slice(3))) tell();
}, true);

window.addEventListener('pointerdown', e => {
  const pad = e.target.closest?.('[data-drive]');
  if (!pad || e.button) return;
  pad.setPointerCapture(e.pointerId);
  fingers.set(e.pointerId, pad.dataset.drive);
  tell();
}, true);
for (const end of ['pointerup', 'pointercancel', 'lostpointercapture'])
  window.addEventListener(end, e => { if (fingers.delete(e.pointerId)) tell(); }, true);
window.addEventListener('contextmenu', e => { if (e.target.closest?.('[data-drive]')) e.preventDefault(); }, true);
window.addEventListener('blur', release);
window.addEventListener('pagehide', release);
document.addEventListener('visibilitychange', release);

connect();
show();
setInterval(() => {
  unanswered++;
  if (pressed && performance.now() - sent > UNCONFIRMED) stop();
  else tell();
  if (performance.now() - Math.max(heard, tried) > (socket.readyState === WebSocket.CLOSED ? 500 : 3000)) connect();
  show();
}, EVERY);
