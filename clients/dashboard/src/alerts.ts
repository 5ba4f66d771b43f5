// The list of alerts: those that somebody must look at first; the newest word on an alert replaces the one before.
import { acknowledge, type Alert } from "./api";
import { clock } from "./words";

const SHOWN_CLEARED = 3;
const RANK = { active: 0, acknowledged: 1, cleared: 2 } as const;
const NAME_KEY = "plumbline-name"; // who acknowledges, remembered in this browser

export class AlertList {
  private alerts = new Map<string, Alert>();

  /** `nameOf` gives the name that a station goes by. */
  constructor(
    private readonly host: HTMLElement,
    private readonly nameOf: (station: string) => string,
  ) {}

  add(alert: Alert): void {
    const known = this.alerts.get(alert.alert_id);
    const stale = known?.state === "acknowledged" && alert.state === "active"; // an event does not know who has seen it
    this.alerts.set(alert.alert_id, { ...known, ...alert, state: stale ? "acknowledged" : alert.state });
    this.render();
  }

  /** Everything that is not cleared, as the server has it now. */
  replaceOpen(open: Alert[]): void {
    const ids = new Set(open.map((a) => a.alert_id));
    for (const [id, alert] of this.alerts) if (alert.state !== "cleared" && !ids.has(id)) this.alerts.delete(id);
    for (const alert of open) this.alerts.set(alert.alert_id, alert);
    this.render();
  }

  /** How many wait for somebody to look, and how many are open in all. */
  get counts(): { active: number; open: number } {
    const open = [...this.alerts.values()].filter((a) => a.state !== "cleared");
    return { active: open.filter((a) => a.state === "active").length, open: open.length };
  }

  /** The worst that a station has open: "alarm", "warning" or nothing. */
  severityOf(station: string): string {
    const open = [...this.alerts.values()].filter((a) => a.station === station && a.state !== "cleared");
    return open.some((a) => a.severity === "alarm") ? "alarm" : open.length ? "warning" : "";
  }

  private render(): void {
    const sorted = [...this.alerts.values()].sort(
      (a, b) => RANK[a.state] - RANK[b.state] || b.onset.localeCompare(a.onset),
    );
    const cleared = sorted.filter((a) => a.state === "cleared").slice(0, SHOWN_CLEARED);
    const shown = [...sorted.filter((a) => a.state !== "cleared"), ...cleared];
    this.host.replaceChildren(...shown.map((alert) => this.row(alert)));
  }

  private row(alert: Alert): HTMLElement {
    const element = document.createElement("div");
    element.className = "alert";
    element.dataset.severity = alert.severity;
    element.dataset.state = alert.state;
    element.dataset.station = alert.station;
    const by = alert.acknowledged_by ? ` by ${alert.acknowledged_by}` : "";
    const state = { active: "active", acknowledged: `seen${by}`, cleared: "over" }[alert.state];
    element.append(
      part("b", alert.severity),
      part("strong", this.nameOf(alert.station)),
      part("span", alert.text),
      part("time", `since ${clock(alert.onset)}`),
      part("em", state),
    );
    if (alert.state === "active") element.append(this.button(alert));
    return element;
  }

  private button(alert: Alert): HTMLElement {
    const button = document.createElement("button");
    button.textContent = "I have seen it";
    button.onclick = () => {
      const name = window.prompt("Your name, for the record", localStorage.getItem(NAME_KEY) ?? "");
      if (name === null) return;
      localStorage.setItem(NAME_KEY, name);
      button.disabled = true;
      acknowledge(alert.alert_id, name)
        .then((seen) => this.add(seen))
        .catch(() => (button.disabled = false));
    };
    return button;
  }
}

function part(tag: string, text: string): HTMLElement {
  const element = document.createElement(tag);
  element.textContent = text;
  return element;
}
