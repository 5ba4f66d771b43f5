// The one WebSocket: reconnects with a growing pause and resumes where it stopped, so that no block is lost in between.
import type { Alert, Attitude, Status } from "./api";
import type { Block } from "./chart";

const DRAWN_RATE_HZ = 20; // the server thins motion out to this

interface Handlers {
  link(state: "live" | "lost", words: string): void;
  status(status: Status): void;
  motion(station: string, block: Block): void;
  attitude(attitude: Attitude): void;
  alert(alert: Alert): void;
}

interface Motion {
  station: string;
  time: string;
  interval_s: number;
  east_mm: number[];
  north_mm: number[];
  up_mm: number[];
  sigma_east_mm: number[];
  sigma_north_mm: number[];
  sigma_up_mm: number[];
}

type Message =
  | { type: "hello"; feed: string }
  | ({ type: "status"; sequence: number } & Status)
  | ({ type: "motion"; sequence: number } & Motion)
  | ({ type: "attitude"; sequence: number } & Attitude)
  | ({ type: "alert"; sequence: number } & Alert)
  | { type: "subscribed" | "missed" | "error" | "solution" };

export class LiveStream {
  private pauseMs = 500;
  private next: number | undefined;
  private feed: string | undefined;

  constructor(private readonly handlers: Handlers) {}

  open(): void {
    const address = new URL("v1/stream", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    socket.onmessage = (event) => this.take(socket, JSON.parse(event.data as string) as Message);
    socket.onclose = () => {
      this.handlers.link("lost", "connection lost, reconnecting …");
      setTimeout(() => this.open(), this.pauseMs);
      this.pauseMs = Math.min(this.pauseMs * 2, 10_000);
    };
  }

  private take(socket: WebSocket, message: Message): void {
    if ("sequence" in message) this.next = message.sequence + 1;
    switch (message.type) {
      case "hello": {
        const resume = this.next === undefined ? {} : { resume_from: this.next, feed: this.feed };
        this.feed = message.feed;
        const channels = ["motion", "status", "alert", "attitude"];
        socket.send(JSON.stringify({ action: "subscribe", channels, motion_rate_hz: DRAWN_RATE_HZ, ...resume }));
        this.pauseMs = 500;
        this.handlers.link("live", "live");
        break;
      }
      case "status":
        this.handlers.status(message);
        break;
      case "motion":
        this.handlers.motion(message.station, {
          start: Date.parse(message.time) / 1000,
          interval: message.interval_s,
          values: [message.east_mm, message.north_mm, message.up_mm],
          sigmas: [message.sigma_east_mm, message.sigma_north_mm, message.sigma_up_mm],
        });
        break;
      case "attitude":
        this.handlers.attitude(message);
        break;
      case "alert":
        this.handlers.alert(message);
        break;
    }
  }
}
