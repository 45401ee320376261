// A teacher who looks at nothing but what the page shows, and holds the arrow of what it wants.
(task) => {
  const number = (element) => parseFloat(element.textContent.replace("\u2212", "-"));
  const seen = (index) => number(document.querySelector(`.seen td[data-obs="${index}"]`));
  const wanted = {
    cartpole: () => 0.1 * seen(0) + 0.3 * seen(1) + 5 * seen(2) + seen(3),
    pendulum: () => {
      const cos = seen(0), speed = seen(2), angle = Math.atan2(seen(1), cos);
      if (cos > 0.8) return 8 * angle + 2 * speed;
      if (Math.abs(speed) < 0.3 && cos < -0.9) return -1;
      return speed * speed / 6 + 5 * cos < 4.7 ? -Math.sign(speed) : Math.sign(speed);
    },
  }[task];
  let held = null;
  const say = (type, key) => window.dispatchEvent(new KeyboardEvent(type, {key, code: key, bubbles: true}));
  setInterval(() => {
    const push = wanted();
    const key = Math.abs(push) < 0.15 ? null : push > 0 ? "ArrowRight" : "ArrowLeft";
    if (key === held) return;
    if (held) say("keyup", held);
    if (key) say("keydown", key);
    held = key;
  }, 30);
}
