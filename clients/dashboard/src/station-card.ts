// One station: its state and the reason for it, the latest displacement, and the live chart.
import { MotionChart, type Block } from "./chart";
import type { Status } from "./api";

const WORDS: Record<string, string> = {
  ppp_float: "PPP",
  ppp_fixed: "PPP fixed",
  ppp_converging: "PPP, converging",
  single_point: "single point",
  no_observations: "no observations",
  no_ephemeris: "no ephemeris",
  no_corrections: "no corrections",
  too_few_satellites: "too few satellites",
};

export class StationCard {
  readonly element = document.createElement("article");
  private chart: MotionChart | undefined;
  private parts: Record<string, HTMLElement> = {};

  constructor(readonly station: string, name: string) {
    this.element.className = "station";
    this.element.dataset.station = station;
    this.element.innerHTML = `
      <div><h2></h2><span class="state" data-part="state" data-state="waiting">waiting</span>
        <span class="facts"><span data-part="mode"></span> <span data-part="satellites"></span></span></div>
      <p class="reason" data-part="reason"></p>
      <div class="readout">
        <span>E <b data-part="e">–</b></span><span>N <b data-part="n">–</b></span><span>U <b data-part="u">–</b></span>
      </div>
      <div class="chart" data-part="chart"></div>`;
    this.element.querySelector("h2")!.textContent = name || station;
    for (const part of this.element.querySelectorAll<HTMLElement>("[data-part]")) this.parts[part.dataset.part!] = part;
  }

  /** Called once the element is on the page, so that the chart knows its width. */
  mounted(): void {
    this.chart = new MotionChart(this.parts.chart!);
  }

  status(status: Status): void {
    const state = this.parts.state!;
    state.textContent = status.state;
    state.dataset.state = status.state;
    this.parts.reason!.textContent = status.reason;
    const solution = status.solution_status;
    this.parts.mode!.textContent = solution ? (WORDS[solution] ?? solution.replaceAll("_", " ")) : "";
    this.parts.satellites!.textContent = status.n_satellites ? `${status.n_satellites} satellites` : "";
  }

  motion(block: Block): void {
    this.chart?.add(block);
    (["e", "n", "u"] as const).forEach((axis, i) => {
      const latest = block.values[i as 0 | 1 | 2].at(-1);
      this.parts[axis]!.textContent = latest === undefined || latest === null ? "–" : `${latest.toFixed(1)} mm`;
    });
  }

  draw(): void {
    this.chart?.draw();
  }
}
