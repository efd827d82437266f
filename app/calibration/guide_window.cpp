#include "app/calibration/guide_window.hpp"

#include <epoxy/gl.h>
#include <fmt/format.h>
#include <imgui.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <thread>
#include <utility>
#include <vector>

#include "app/logging.hpp"
#include "app/output/run_outputs.hpp"
#include "app/run/session_host.hpp"
#include "app/window/hud.hpp"
#include "core/propagate.hpp"

namespace penumbra {
namespace {

constexpr double kFlash_ms = 700.0;  // duration of the green frame around an accepted view
constexpr int kSmallestWidth = 960;  // minimum initial window width [px], for small images
constexpr std::chrono::milliseconds kRest(15);  // pause between two refreshes in wait()

constexpr ImGuiWindowFlags kPanel = ImGuiWindowFlags_NoDecoration | ImGuiWindowFlags_NoMove |
                                    ImGuiWindowFlags_NoSavedSettings | ImGuiWindowFlags_NoInputs |
                                    ImGuiWindowFlags_NoFocusOnAppearing | ImGuiWindowFlags_NoNav |
                                    ImGuiWindowFlags_AlwaysAutoResize;
constexpr ImU32 kMissing = IM_COL32(255, 120, 60, 46);
constexpr ImU32 kMissingEdge = IM_COL32(255, 150, 90, 150);
constexpr ImU32 kNext = IM_COL32(255, 225, 60, 255);
constexpr ImU32 kGreen = IM_COL32(70, 215, 110, 255);
constexpr ImU32 kAmber = IM_COL32(255, 190, 60, 255);
constexpr ImU32 kRed = IM_COL32(255, 110, 90, 255);
constexpr ImU32 kDark = IM_COL32(0, 0, 0, 170);

void words(const std::string& text) {
  ImGui::TextUnformatted(text.data(), text.data() + text.size());
}
void words(ImU32 color, const std::string& text) {
  ImGui::PushStyleColor(ImGuiCol_Text, color);
  words(text);
  ImGui::PopStyleColor();
}

void draw_missing_cells(const GuideHud& hud, const ImageArea& area, float em) {
  const GuideCoverage& coverage = hud.progress.coverage;
  if (coverage.columns <= 0 || coverage.rows <= 0) return;
  ImDrawList& list = *ImGui::GetBackgroundDrawList();
  const float w = static_cast<float>(area.width) / static_cast<float>(coverage.columns);
  const float h = static_cast<float>(area.height) / static_cast<float>(coverage.rows);
  for (std::size_t i = 0; i < coverage.seen.size(); ++i) {
    if (coverage.seen[i]) continue;
    const auto column = static_cast<float>(i % static_cast<std::size_t>(coverage.columns));
    const auto row = static_cast<float>(i / static_cast<std::size_t>(coverage.columns));
    const ImVec2 at(static_cast<float>(area.x) + column * w, static_cast<float>(area.y) + row * h);
    const ImVec2 to(at.x + w, at.y + h);
    list.AddRectFilled(at, to, kMissing);
    list.AddRect(at, to, kMissingEdge);
    if (coverage.next == i) {
      const float inset = 0.25F * em;
      list.AddRect({at.x + inset, at.y + inset}, {to.x - inset, to.y - inset}, kNext, 0.3F * em, 0,
                   0.2F * em);
    }
  }
}

void draw_corners(const GuideHud& hud, const ImageArea& area, float em) {
  ImDrawList& list = *ImGui::GetBackgroundDrawList();
  const double scale = static_cast<double>(area.width) / hud.width;
  const float radius = std::max(2.0F, 0.16F * em);
  for (const TargetCorner& corner : hud.look.corners) {
    const Eigen::Vector2d& pixel = corner.pixel;
    // The centre of pixel 0 lies half a pixel from the edge.
    const ImVec2 at(static_cast<float>(area.x + scale * (pixel.x() + 0.5)),
                    static_cast<float>(area.y + scale * (pixel.y() + 0.5)));
    list.AddCircleFilled(at, radius + 1.0F, kDark, 12);
    list.AddCircleFilled(at, radius, hud.look.taken ? kGreen : kAmber, 12);
  }
  if (hud.flash > 0.0) {
    const auto alpha = static_cast<int>(255.0 * std::min(hud.flash, 1.0));
    list.AddRect(
        {static_cast<float>(area.x), static_cast<float>(area.y)},
        {static_cast<float>(area.x + area.width), static_cast<float>(area.y + area.height)},
        IM_COL32(70, 215, 110, alpha), 0.0F, 0, 0.7F * em);
  }
}

void bar(const char* name, double fraction, float em) {
  words(name);
  ImGui::SameLine(5.0F * em);
  ImGui::PushStyleColor(ImGuiCol_PlotHistogram, fraction >= 1.0 ? kGreen : kAmber);
  const auto filled = static_cast<float>(std::clamp(fraction, 0.0, 1.0));
  ImGui::ProgressBar(filled, {11.0F * em, 1.1F * em}, "");
  ImGui::PopStyleColor();
  ImGui::SameLine();
  words(fmt::format("{:.0f} %", 100.0 * static_cast<double>(filled)));
}

void bars(const GuideHud& hud, GlContext::Size size, float em) {
  const GuideProgress& progress = hud.progress;
  ImGui::SetNextWindowPos({0.5F * em, static_cast<float>(size.height) - 0.5F * em},
                          ImGuiCond_Always, {0.0F, 1.0F});
  ImGui::Begin("bars", nullptr, kPanel);
  bar("image", progress.image, em);
  bar("size", progress.size, em);
  bar("tilt", progress.tilt, em);
  bar("certainty", progress.certainty, em);
  words(progress.largest_px
            ? fmt::format("{} views, projection to {:.2f} px", progress.views, *progress.largest_px)
            : fmt::format("{} views, no lens yet", progress.views));
  ImGui::End();
}

void advice(const GuideHud& hud, GlContext::Size size, float em) {
  ImGui::SetNextWindowPos({0.5F * static_cast<float>(size.width), 0.5F * em}, ImGuiCond_Always,
                          {0.5F, 0.0F});
  ImGui::Begin("advice", nullptr, kPanel);
  ImGui::SetWindowFontScale(1.4F);
  words(hud.progress.enough ? kGreen : kNext, hud.progress.advice);
  ImGui::SetWindowFontScale(1.0F);
  if (hud.look.taken || hud.flash > 0.0) {
    words(kGreen, fmt::format("view {} taken", hud.progress.views));
  } else {
    words(hud.look.why);
  }
  ImGui::End();
}

void verdict(const GuideHud& hud, GlContext::Size size, float em) {
  ImGui::SetNextWindowPos(
      {0.5F * static_cast<float>(size.width), 0.5F * static_cast<float>(size.height)},
      ImGuiCond_Always, {0.5F, 0.5F});
  ImGui::Begin("verdict", nullptr, kPanel);
  const float width = std::min(40.0F * em, static_cast<float>(size.width) - 3.0F * em);
  ImGui::PushTextWrapPos(width);
  if (hud.grade || hud.failed) {
    const bool good = hud.grade == CalibrationGrade::good;
    const bool usable = hud.grade == CalibrationGrade::usable;
    ImGui::SetWindowFontScale(1.4F);
    words(good     ? kGreen
          : usable ? kAmber
                   : kRed,
          hud.grade ? std::string(to_string(*hud.grade)) : "no calibration");
    ImGui::SetWindowFontScale(1.0F);
  }
  // Removes the grade, which is drawn above.
  const std::string grade = hud.grade ? std::string(to_string(*hud.grade)) + ": " : std::string();
  words(hud.words.starts_with(grade) ? hud.words.substr(grade.size()) : hud.words);
  if (hud.grade || hud.failed) words("Press a key " + hud.after_key + ".");
  ImGui::PopTextWrapPos();
  ImGui::End();
}

void draw_guide(Overlay& overlay, const GuideHud& hud, GlContext::Size size) {
  if (hud.width <= 0 || hud.height <= 0) return;
  overlay.draw_custom(size, [&](float em) {
    const ImageArea area = image_area(hud.width, hud.height, size);
    draw_missing_cells(hud, area, em);
    if (!hud.words.empty()) {
      verdict(hud, size, em);
      return;
    }
    draw_corners(hud, area, em);
    bars(hud, size, em);
    advice(hud, size, em);
  });
}

}  // namespace

Result<std::unique_ptr<GuideWindow>> GuideWindow::open(int width, int height) {
  const double scale = std::max(1.0, static_cast<double>(kSmallestWidth) / width);
  PENUMBRA_TRY(auto context, open_window({static_cast<int>(scale * width + 0.5),
                                          static_cast<int>(scale * height + 0.5)},
                                         true));
  PENUMBRA_TRY(auto overlay, Overlay::create(*context));
  PENUMBRA_TRY(auto framebuffer, Framebuffer::create(width, height));
  framebuffer.bind();
  glClearColor(0.0F, 0.0F, 0.0F, 1.0F);
  glClear(GL_COLOR_BUFFER_BIT);
  std::unique_ptr<GuideWindow> window(
      new GuideWindow(std::move(context), std::move(overlay), std::move(framebuffer)));
  window->hud_.width = width;
  window->hud_.height = height;
  window->hud_.words = "waiting for the camera";
  return window;
}

GuideWindow::GuideWindow(std::unique_ptr<GlContext> context, std::unique_ptr<Overlay> overlay,
                         Framebuffer framebuffer)
    : context_(std::move(context)),
      overlay_(std::move(overlay)),
      framebuffer_(std::move(framebuffer)),
      video_(context_->info().api, !context_->info().software) {
  context_->on_event([this](const WindowEvent& event) { take(event); });
}

GuideWindow::~GuideWindow() {
  context_->on_event({});
}

Result<void> GuideWindow::show(const Frame& frame, GuideResult look, GuideProgress progress) {
  frame_ = frame;
  (void)video_.upload(frame_);
  framebuffer_.bind();
  PENUMBRA_TRY_VOID(video_.draw(frame_));
  video_.hold(frame_);
  if (look.taken) {
    taken_ = true;
    since_taken_.restart();
  }
  hud_.look = std::move(look);
  hud_.progress = std::move(progress);
  hud_.words.clear();
  return {};
}

void GuideWindow::say(std::string words, std::optional<CalibrationGrade> grade, bool failed) {
  hud_.words = std::move(words);
  hud_.grade = grade;
  hud_.failed = failed;
}

void GuideWindow::take(const WindowEvent& event) {
  if (event.kind != WindowEvent::Kind::key_down) return;
  const auto command = command_of_key(event);
  if (command == WindowCommand::screenshot) {
    save_requested_ = true;
  } else if (command == WindowCommand::full_screen) {
    context_->toggle_full_screen();
  } else {
    key_pressed_ = true;
    if (command == WindowCommand::quit) closed_ = true;
  }
}

void GuideWindow::refresh() {
  const GlContext::Size size = context_->window_size();
  hud_.flash = taken_ ? std::max(0.0, 1.0 - since_taken_.elapsed().wall_ms / kFlash_ms) : 0.0;
  framebuffer_.present(size);
  draw_guide(*overlay_, hud_, size);
  if (std::exchange(save_requested_, false)) save_window_image();
  context_->swap();
  if (!context_->poll_events()) closed_ = true;
}

void GuideWindow::save_window_image() {
  const GlContext::Size size = context_->window_size();
  if (size.width <= 0 || size.height <= 0) return;
  const std::size_t row = static_cast<std::size_t>(size.width) * 4U;
  std::vector<std::uint8_t> upside_down(row * static_cast<std::size_t>(size.height));
  glBindFramebuffer(GL_READ_FRAMEBUFFER, 0);
  glPixelStorei(GL_PACK_ALIGNMENT, 4);
  glReadPixels(0, 0, size.width, size.height, GL_RGBA, GL_UNSIGNED_BYTE, upside_down.data());
  std::vector<std::uint8_t> rgba;
  rgba.reserve(upside_down.size());
  for (int y = size.height - 1; y >= 0; --y) {
    const auto begin = upside_down.begin() + static_cast<std::ptrdiff_t>(row) * y;
    rgba.insert(rgba.end(), begin, begin + static_cast<std::ptrdiff_t>(row));
  }
  log_info("{}", save_screenshot_png(size.width, size.height, rgba));
}

void GuideWindow::wait(InterruptWatch& interrupt, const std::string& purpose) {
  hud_.after_key = purpose;
  key_pressed_ = false;
  while (!closed_ && !key_pressed_ && !interrupt.interrupted()) {
    refresh();
    std::this_thread::sleep_for(kRest);
  }
}

}  // namespace penumbra
