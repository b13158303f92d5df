// The kinds of events: lanes of the time line, words, and whether the lane is there without any.

export const KINDS = [
  { kind: "command", lane: "Commands", words: "command", isAlways: true },
  { kind: "engaged", lane: "Engagements", words: "engagement", isAlways: true },
  { kind: "aborted", lane: "Aborts", words: "abort", isAlways: true },
  { kind: "completed", lane: "Completions", words: "completion", isAlways: true },
  { kind: "missed", lane: "Misses", words: "missed command", isAlways: true },
  { kind: "timed_out", lane: "Timed out", words: "timed out", isAlways: false },
  { kind: "horizon", lane: "Episode over", words: "episode over", isAlways: false },
  { kind: "collision", lane: "Collisions", words: "collision", isAlways: true },
  { kind: "off_road", lane: "Off the road", words: "off the road", isAlways: true },
  { kind: "braking", lane: "Hard braking", words: "hard braking", isAlways: true },
];
