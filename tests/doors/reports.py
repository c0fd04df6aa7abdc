"""reports.py - looks at reports in Chromium: what they draw, their switches, keys and paper.

Usage: reports.py PICTURES ASSET.html TILES.html MISSES.html COMPARISON.html NORMAL.json
NORMAL.json is what bisque-compare says of the asset's normals.
Prints TAP lines for tests/run.sh. PICTURES is a folder for screenshots."""
import json
import re
import sys

from browser import Browser

pictures, asset, tiles, misses, comparison, normal = sys.argv[1:]
browser = Browser()
count = 0


def check(name, good, *facts):
    global count
    count += 1
    print(f"{'ok' if good else 'not ok'} {count} - {name}", *([] if good else ["#", *facts]), flush=True)


# The mean difference, of 255, between what is drawn and the preview's picture of view `view`: its
# panel of the mesh with maps (1) or without (0); and the share of the panel that the mesh covers.
COMPARE = """(async (view, panel) => {
  const preview = [...document.querySelectorAll('script.item')].map(e => JSON.parse(e.textContent))
    .find(item => item.kind === 'preview');
  const image = new Image();
  await new Promise(done => { image.onload = done; image.src = 'data:image/png;base64,' + preview.data; });
  const side = (image.width - 8) / 3;
  const read = draw => {
    const context = Object.assign(document.createElement('canvas'), {width: side, height: side}).getContext('2d');
    draw(context);
    return context.getImageData(0, 0, side, side).data;
  };
  const drawn = read(c => c.drawImage(document.getElementById('view'), 0, 0, side, side));
  const given = read(c => c.drawImage(image, panel * (side + 4), view * (side + 28), side, side, 0, 0, side, side));
  let sum = 0, covered = 0;
  for (let i = 0; i < drawn.length; i += 4) {
    if (drawn[i + 3] < 255) continue;
    covered++;
    for (let k = 0; k < 3; k++) sum += Math.abs(drawn[i + k] - given[i + k]) / 3;
  }
  return [sum / covered, covered / side / side];
})"""
SHOWN = "document.getElementById('view').toDataURL()"
SWITCHES = "[...document.querySelectorAll('#controls input')].map(e => [e.type, e.name, e.value])"


def click(kind, name, value):
    browser.js(f"document.querySelector(`#controls input[name='{name}'][value='{value}']`).click()")


def check_drawing(name, most=1.5):
    same, covered = browser.js(COMPARE + "(0, 1)")
    other, _ = browser.js(COMPARE + "(1, 1)")
    check(f"{name}: drawn as in the preview, by {same:.2f} of 255", same < most and covered > 0.15, same, covered)
    check(f"{name}: another view differs, by {other:.2f}", other > most, other)


def check_ready(name, path):
    ready = browser.open(path)
    check(f"{name}: shows without errors in the console", ready == "yes" and not browser.problems, ready, browser.problems)


def check_switches():
    start = browser.js(SHOWN)
    for kind, name, value in browser.js(SWITCHES):
        if (name, value) == ("show", ""):
            continue
        click(kind, name, value)
        changed = browser.js(SHOWN)
        click(*(("radio", "show", "") if kind == "radio" else (kind, name, value)))
        # Without misses, the switch of misses shows none.
        check(f"switch {name} {value}: changes the picture, and back",
              (changed != start) != (name == "misses") and browser.js(SHOWN) == start)
    click("checkbox", "normal", "on"), click("checkbox", "color", "on")
    plain, _ = browser.js(COMPARE + "(0, 0)")
    check(f"without maps: drawn as the plain mesh, by {plain:.2f}", plain < 3, plain)
    click("checkbox", "normal", "on"), click("checkbox", "color", "on")
    browser.js("document.querySelectorAll('#views button')[1].click()")
    turned, _ = browser.js(COMPARE + "(1, 1)")
    check("the button of a view shows it", turned < 3, turned)
    check("beside the scan from there", "view 2 of" in browser.js("document.getElementById('scan-caption').textContent"))


def check_keys():
    reached = []
    browser.js("document.activeElement.blur()")
    for _ in range(20):
        browser.key("Tab", 9)
        reached.append(browser.js("(e => e.id || e.name || e.textContent)(document.activeElement)"))
    check("Tab reaches all controls", {"view", "1", "show", "normal", "wireframe", "command"} <= set(reached), reached)
    browser.js("document.getElementById('view').focus()")
    browser.key("Home", 36)
    home = browser.js(SHOWN)
    for key, code in ("ArrowLeft", 37), ("ArrowUp", 38), ("+", 187):
        before = browser.js(SHOWN)
        browser.key(key, code)
        check(f"{key} changes the picture", browser.js(SHOWN) != before)
    browser.key("Home", 36)
    check("Home resets it", browser.js(SHOWN) == home)


def check_texts():
    data = json.loads(browser.js("document.getElementById('data').textContent"))
    text = browser.js("document.body.innerText")
    names = browser.js("[...document.querySelectorAll('#maps h3')].map(e => e.textContent)")
    check("all maps are shown", names == list(data["maps"]), names)
    low, high = data["encodings"]["height"]["range"], browser.js(
        "[...document.querySelectorAll('#maps article')].find(e => e.innerText.startsWith('height')).innerText")
    largest = max(abs(float(v)) for v in re.search(r"Range: (\S+) to (\S+)", high).groups())
    check("the range of heights is that of the bake", abs(largest / low - 1) < 0.01, largest, low)
    shown = browser.js("[...document.querySelectorAll('#errors article')].map(e => e.innerText)")
    given = json.load(open(normal, encoding="utf-8"))
    check("maps with a reference are compared with it", [n in t for n, t in zip(["v_normal.exr", "v_mask.exr"], shown)] ==
          [True, True] and len(shown) == 2, shown)
    check("with the figures of bisque-compare", all(f"{given[key]:.4g}" in shown[0] for key in ("mean", "p99", "max")), given)
    check("figures of data have no unit", re.search(r"mean\s+0\n", shown[1]), shown[1])
    command = browser.js("document.getElementById('command').textContent")
    check("the command is quoted", "'v_<MAP>.exr'" in command and command.startswith("bisque-bake "), command)
    rows = browser.js("document.querySelectorAll('#options tr').length")
    check("all options are shown", rows == len(data["options"]) > 40, rows)
    check("times and memory are shown", "trace" in text and "memory used at most" in text)


def check_paper():
    browser.call("Emulation.setEmulatedMedia", media="print")
    hidden = browser.js("getComputedStyle(document.getElementById('controls')).display")
    check("prints without switches", hidden == "none" and browser.pdf_bytes() > 50000)
    browser.call("Emulation.setEmulatedMedia", media="")


def check_size():
    text = open(asset, encoding="utf-8").read()
    rest = re.sub(r'<script type="application/json" class="item">.*?</script>', "", text, flags=re.S)
    check("below 1 MB without pictures and mesh", len(rest.encode()) < 1e6, len(rest.encode()))
    check("nothing is loaded from elsewhere", not re.search(r'(src|href)="(?!data:)', re.sub(r"<script>.*?</script>", "", rest, flags=re.S)))
    check_ready("without three.js", strip(text))
    check("without three.js: the preview", browser.js(
        "document.getElementById('preview').naturalWidth > 500 && document.getElementById('asset').hidden"))


def strip(text):
    path = f"{pictures}/without_three.html"
    with open(path, "w", encoding="utf-8") as file:
        file.write(text[:text.index("<script>")] + text[text.index('<script type="application/json"'):])
    return path


check_ready("a bake", asset)
check_drawing("a bake")
browser.screenshot(f"{pictures}/bake.png")
check_texts()
check_switches()
check_keys()
check_paper()
check_size()
check_ready("two UDIM tiles", tiles)
check_drawing("two UDIM tiles")
check_ready("misses", misses)
check_drawing("misses")
browser.screenshot(f"{pictures}/misses.png")
red = browser.js("""(c => { const p = c.getContext('2d').getImageData(0, 0, c.width, c.height).data; let n = 0;
    for (let i = 0; i < p.length; i += 4) n += p[i] > 150 && p[i + 1] < 90; return n / p.length * 4; })(
    document.querySelector('#misses canvas'))""")
check("misses are red in the charts", 0.02 < red < 0.6, red)
check("and said in words", "misses:" in browser.js("document.getElementById('lost').innerText"))
check_ready("a comparison", comparison)
mean = json.loads(browser.js("document.getElementById('data').textContent"))["mean"]
check("its figures", f"{mean:.4g}" in browser.js("document.querySelector('#errors table').innerText"), mean)
browser.js("document.querySelector('.slider input').focus()")
for _ in range(20):
    browser.key("ArrowRight", 39)
split = browser.js("document.querySelector('.slider').style.getPropertyValue('--split')")
check("the slider moves by keys", split == "60%", split)
browser.screenshot(f"{pictures}/comparison.png")
browser.close()
