// Entry of a file that holds its trajectory.

import { Player } from "replay/player";

function read(id) {
  return JSON.parse(document.getElementById(id).textContent);
}

async function start() {
  const player = new Player(document, read("header"));
  // For the browser's console, and for tests.
  window.player = player;
  player.setOptima(read("optima"));
  await player.store.append(...read("chunks"));
  player.start();
}

start().catch((error) => {
  const message = document.getElementById("message");
  message.textContent = `This replay cannot be shown: ${error.message}`;
  message.hidden = false;
  throw error;
});
