// The list of alerts: active ones first, in words; the newest event of an alert replaces the one before.
import type { Alert } from "./api";

const SHOWN_CLEARED = 3;

export class AlertList {
  private alerts = new Map<string, Alert>();

  constructor(private readonly host: HTMLElement) {}

  add(alert: Alert): void {
    this.alerts.set(alert.alert_id, alert);
    this.render();
  }

  get active(): number {
    return [...this.alerts.values()].filter((a) => a.state !== "cleared").length;
  }

  private render(): void {
    const newestFirst = [...this.alerts.values()].sort((a, b) => b.onset.localeCompare(a.onset));
    const cleared = newestFirst.filter((a) => a.state === "cleared").slice(0, SHOWN_CLEARED);
    const shown = [...newestFirst.filter((a) => a.state !== "cleared"), ...cleared];
    this.host.replaceChildren(...shown.map(row));
  }
}

function row(alert: Alert): HTMLElement {
  const element = document.createElement("div");
  element.className = "alert";
  element.dataset.severity = alert.severity;
  element.dataset.state = alert.state;
  element.dataset.station = alert.station;
  const parts: [string, string][] = [
    ["b", alert.state === "cleared" ? "cleared" : alert.severity],
    ["span", alert.station],
    ["span", alert.text],
    ["time", new Date(alert.onset).toLocaleTimeString()],
  ];
  element.append(
    ...parts.map(([tag, text]) => {
      const part = document.createElement(tag);
      part.textContent = text;
      return part;
    }),
  );
  return element;
}
