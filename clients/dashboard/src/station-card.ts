// One station: its state and the reason for it, where it is now, how it is turned, and the live chart.
import { explain, type Attitude, type Status } from "./api";
import { MotionChart, type Block } from "./chart";
import { number, statusWords } from "./words";

const AXES = ["e", "n", "u"] as const;
const ANGLES = ["roll", "pitch", "heading"] as const;
const PARTS = `
  <div class="head"><h2></h2><span class="state" data-part="state" data-state="waiting">waiting</span>
    <span class="grade" data-part="grade" hidden></span><span class="facts" data-part="satellites"></span></div>
  <p class="reason" data-part="reason" hidden></p>
  <div class="readout">
    ${AXES.map((a) => `<span>${a.toUpperCase()} <b data-part="${a}">–</b><i data-part="sigma-${a}"></i></span>`).join("")}
  </div>
  <div class="attitude" data-part="attitude" hidden>
    ${ANGLES.map((a) => `<span>${a} <b data-part="${a}">–</b><i data-part="sigma-${a}"></i></span>`).join("")}
  </div>
  <div class="chart" data-part="chart"></div>
  <details data-part="why"><summary>What limits it?</summary><ul data-part="findings"></ul></details>`;

export class StationCard {
  readonly element = document.createElement("article");
  private chart: MotionChart | undefined;
  private parts: Record<string, HTMLElement> = {};
  private state = "waiting";
  private grade = "fair";

  readonly name: string;

  constructor(readonly station: string, name: string, mode: string) {
    this.name = name || station;
    this.element.className = "station";
    this.element.dataset.station = station;
    this.element.innerHTML = PARTS;
    this.element.querySelector("h2")!.textContent = this.name;
    this.element.querySelector("h2")!.title = `${station}, mode ${mode}`;
    for (const part of this.element.querySelectorAll<HTMLElement>("[data-part]")) this.parts[part.dataset.part!] = part;
    this.parts.why!.addEventListener("toggle", () => void this.explain());
  }

  /** Called once the element is on the page, so that the chart knows its width. */
  mounted(): void {
    this.chart = new MotionChart(this.parts.chart!);
  }

  status(status: Status): void {
    this.state = status.state;
    this.text("state", status.state);
    this.parts.state!.dataset.state = status.state;
    this.text("reason", status.reason);
    this.parts.reason!.hidden = !status.reason;
    const [words, grade] = status.solution_status ? statusWords(status.solution_status) : ["", "fair"];
    this.grade = grade;
    this.text("grade", words);
    this.parts.grade!.hidden = !words || status.state !== "receiving";
    this.parts.grade!.dataset.grade = grade;
    this.text("satellites", status.n_satellites && status.state === "receiving" ? `${status.n_satellites} satellites` : "");
  }

  /** Where it stands among the others: what somebody must look at comes first. */
  rank(severity: string): void {
    this.element.dataset.severity = severity;
    const trouble = this.state === "silent" ? 2 : this.state !== "receiving" || this.grade === "bad" ? 3 : 4;
    this.element.style.order = String(severity === "alarm" ? 0 : severity === "warning" ? 1 : trouble);
  }

  motion(block: Block): void {
    this.chart?.add(block);
    AXES.forEach((axis, i) => {
      const latest = block.values[i as 0 | 1 | 2].at(-1);
      const sigma = block.sigmas[i as 0 | 1 | 2].at(-1);
      this.text(axis, latest == null ? "–" : `${number(latest, 1)} mm`);
      this.text(`sigma-${axis}`, sigma == null ? "" : ` ± ${number(sigma, 1)}`);
    });
  }

  attitude(attitude: Attitude): void {
    this.parts.attitude!.hidden = false;
    for (const angle of ANGLES) {
      const [value, sigma] = [attitude[`${angle}_deg`], attitude[`sigma_${angle}_deg`]];
      this.text(angle, value === null ? "–" : `${number(value, 3)}°`);
      this.text(`sigma-${angle}`, sigma === null ? "" : ` ± ${number(sigma, 3)}`);
    }
  }

  draw(): void {
    this.chart?.draw();
  }

  private text(part: string, text: string): void {
    this.parts[part]!.textContent = text;
  }

  private async explain(): Promise<void> {
    if (!(this.parts.why as HTMLDetailsElement).open) return;
    const lines = await explain(this.station).then(
      (told) => told.findings.map((f) => `${f.text}${f.advice ? ` — ${f.advice}` : ""} (${Math.round(100 * f.share)} %)`),
      () => ["The server does not answer."],
    );
    const items = (lines.length ? lines : ["Nothing: all of the last epochs are good."]).map((line) => {
      const item = document.createElement("li");
      item.textContent = line;
      return item;
    });
    this.parts.findings!.replaceChildren(...items);
  }
}
