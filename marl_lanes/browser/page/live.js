// Entry of a page that shows a running simulation: its stream, and the newest of it.

import { Player } from "replay/player";

/** [s] What is shown is behind the newest by so much when rows arrive: so the next are in time. */
const DELAY = 0.75;
/** [s] Farther behind, the page jumps; nearer, it plays a little slower or faster. */
const JUMP = 3;
const MAX_CORRECTION = 0.2;
/** [ms] After which it asks again when the server has refused. */
const RETRY = 3000;
/** [ms] For which it says what is new. */
const NOTICE = 5000;

export class Live {
  constructor(page) {
    this.page = page;
    this.element = (id) => page.getElementById(id);
    this.player = null;
    this.source = null;
    /** The episode that is shown, {name, speed, header}. */
    this.episode = null;
    /** Episodes and rows that are not shown yet: [kind, data]. */
    this.queue = [];
    this.status = { waiting: null, trouble: null };
    this.connection = "connecting";
    this.notice = "";
    this.isFollowing = true;
    this.isPressed = false;
    this.isDraining = false;
    this.isMoving = false;
    this.listen();
    this.connect();
  }

  listen() {
    const { page } = this;
    this.element("live").hidden = false;
    this.element("title").textContent = page.title;
    page.querySelector("main").hidden = true;
    this.element("to-live").addEventListener("click", () => this.follow());
    // Rows that arrive would take away what is being clicked.
    page.addEventListener("pointerdown", () => {
      this.isPressed = true;
    });
    for (const end of ["pointerup", "pointercancel"]) {
      page.addEventListener(end, () => {
        this.isPressed = false;
        // The click comes after it.
        window.setTimeout(() => this.drain());
      });
    }
    // A page that is not seen takes no connection; browsers have only six for a server.
    page.addEventListener("visibilitychange", () => {
      if (page.hidden) this.disconnect();
      else this.connect();
    });
  }

  connect() {
    if (this.source || this.page.hidden) return;
    const source = new EventSource("/stream");
    this.source = source;
    source.addEventListener("open", () => this.setConnection("open"));
    source.addEventListener("error", () => {
      this.setConnection("lost");
      // It tries again by itself, but not after a refusal.
      if (source.readyState !== EventSource.CLOSED) return;
      this.disconnect();
      window.setTimeout(() => this.connect(), RETRY);
    });
    for (const kind of ["status", "episode", "rows"]) {
      source.addEventListener(kind, (event) => this.receive(kind, JSON.parse(event.data)));
    }
  }

  disconnect() {
    this.source?.close();
    this.source = null;
  }

  setConnection(connection) {
    const isBack = connection === "open" && this.connection === "lost";
    this.connection = connection;
    if (isBack) this.notify("Connected again.");
    else this.show();
  }

  /** Say something for a while. */
  notify(notice) {
    this.notice = notice;
    this.show();
    window.setTimeout(() => {
      if (this.notice === notice) this.notice = "";
      this.show();
    }, NOTICE);
  }

  receive(kind, data) {
    if (kind === "status") {
      this.status = data;
    } else {
      // An episode that nobody has looked at gives way to the next.
      const pending = this.queue.findIndex(([one]) => one === "episode");
      if (kind === "episode" && pending >= 0) this.queue.length = pending;
      this.queue.push([kind, data]);
      this.drain();
    }
    // Where it is draining already, what has come is not said before that ends.
    this.show();
  }

  /** Take from the queue what may be shown now. */
  async drain() {
    if (this.isDraining) return;
    this.isDraining = true;
    try {
      while (this.queue.length && !this.isPressed) {
        const [kind, data] = this.queue[0];
        if (kind === "episode") {
          if (!this.mayBegin(data)) break;
          this.queue.shift();
          this.begin(data);
        } else {
          await this.append(this.takeRows());
        }
      }
    } finally {
      this.isDraining = false;
    }
    this.show();
  }

  get isPending() {
    return this.queue.some(([kind, data]) => kind === "episode" && !this.isShown(data));
  }

  isShown(episode) {
    return this.episode?.name === episode.name;
  }

  /** Whether an episode may take the place of the one that is shown. */
  mayBegin(episode) {
    return !this.episode || this.isFollowing || this.isShown(episode);
  }

  begin(episode) {
    if (this.isShown(episode)) return;
    const isOther = this.episode && describeRoad(this.episode) !== describeRoad(episode);
    // Another server has taken this one's place: nothing of this page fits.
    if (isOther) {
      window.location.reload();
      return;
    }
    const { policy } = episode.header;
    if (this.episode && policy !== this.episode.header.policy) this.notify(`Now ${policy} drives.`);
    this.episode = episode;
    if (this.player) this.player.restart(episode.header);
    else {
      this.page.querySelector("main").hidden = false;
      this.player = new Player(this.page, episode.header);
      window.player = this.player;
    }
  }

  takeRows() {
    const end = this.queue.findIndex(([kind]) => kind === "episode");
    const taken = this.queue.splice(0, end < 0 ? this.queue.length : end);
    return taken.map(([, chunk]) => chunk);
  }

  async append(chunks) {
    const { store } = this.player;
    const isFirst = store.chunks.length === 0;
    // A stream that comes back begins with rows that are here already.
    const fresh = chunks.filter((chunk) => isFirst || chunk.first_step > store.lastStep);
    if (!fresh.length) return;
    if (!isFirst && this.isGap(fresh[0])) store.clear();
    await store.append(...fresh);
    if (!this.player.transport) this.start();
    this.page.title = `${this.episode.header.scenario}: live`;
    if (this.isFollowing) this.keepUp(isFirst);
  }

  /** Whether steps are missing before a chunk, more than a road without vehicles explains. */
  isGap(chunk) {
    const { store } = this.player;
    return (chunk.first_step - store.lastStep) * store.timeStep > 2 * DELAY * this.episode.speed;
  }

  start() {
    const { player } = this;
    // The address of an earlier visit is one of the past.
    window.history.replaceState(null, "", window.location.pathname);
    player.start();
    player.clock.addEventListener("seek", () => this.noteWish());
    player.clock.addEventListener("state", () => this.noteWish());
  }

  /** [s] Of the road, behind the newest. */
  get lag() {
    return this.player.store.lastTime - this.player.clock.time;
  }

  /** Play at the newest. */
  keepUp(isFirst) {
    const { clock } = this.player;
    const { speed } = this.episode;
    const error = this.lag / speed - DELAY;
    this.move(() => {
      clock.isOpen = true;
      if (isFirst || error > JUMP) clock.seek(clock.last - DELAY * speed);
      if (clock.speed !== speed) this.setSpeed(speed);
      if (!clock.isPlaying) clock.play();
    });
    clock.pace = 1 + Math.min(Math.max(0.2 * error, -MAX_CORRECTION), MAX_CORRECTION);
  }

  setSpeed(speed) {
    const choice = this.element("speed");
    const value = String(speed);
    if (![...choice.options].some((one) => one.value === value)) {
      choice.add(new Option(`${value}×`, value));
    }
    this.player.clock.setSpeed(speed);
  }

  /** Change the clock, which is then no wish of the viewer's. */
  move(change) {
    this.isMoving = true;
    change();
    this.isMoving = false;
  }

  /** The viewer has sought, paused, played or chosen a speed: is that still live? */
  noteWish() {
    if (this.isMoving) return;
    const { clock } = this.player;
    const { speed } = this.episode;
    const isNear = this.lag < 2 * DELAY * speed;
    this.setFollowing(isNear && clock.isPlaying && clock.speed === speed && !this.isPending);
  }

  setFollowing(isFollowing) {
    if (this.isFollowing === isFollowing) return;
    if (isFollowing) {
      this.follow();
      return;
    }
    this.isFollowing = false;
    this.player.clock.pace = 1;
    this.show();
  }

  /** Back to live. */
  follow() {
    this.isFollowing = true;
    if (!this.isPending) this.keepUp(true);
    this.drain();
  }

  /** What the page says about the stream. */
  show() {
    const { isFollowing, connection } = this;
    const isLost = connection === "lost";
    if (this.player) this.player.clock.isOpen = isFollowing || !this.isPending;
    const badge = this.element("live-badge");
    badge.classList.toggle("on", isFollowing && !isLost && this.episode !== null);
    this.element("to-live").hidden = isFollowing;
    const [words, isWarning] = this.describe();
    const text = this.element("live-text");
    if (text.textContent !== words) text.textContent = words;
    text.classList.toggle("warning", isWarning);
  }

  /** In words, and whether something is wrong. */
  describe() {
    const { status, connection, notice, isFollowing } = this;
    if (connection === "lost") return ["Connection lost; trying again.", true];
    if (connection === "connecting") return ["Connecting.", false];
    const words = [notice];
    if (status.waiting) words.push(`${capitalise(status.waiting)}.`);
    // One who follows sees it in a moment.
    if (this.isPending && !isFollowing) words.push("Another episode has begun.");
    if (status.trouble) words.push(`${capitalise(status.trouble)}.`);
    return [words.filter(Boolean).join(" "), Boolean(status.trouble)];
  }
}

function capitalise(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

/** What of an episode must stay the same for a page. */
function describeRoad({ header }) {
  return JSON.stringify({ ...header, policy: "", seed: 0 });
}

// For the browser's console, and for tests.
window.live = new Live(document);
