// Has StellarSolver, Ekos' library, solve an image by a command on this computer, and prints what it understood.
//
// Arguments: FITS-FILE RAW-FILE WIDTH HEIGHT SCALE RA DEC FOLDER astap|astrometry|watney image|stars
// RAW-FILE: 16-bit pixels of this machine's byte order, the first row first. SCALE: arcsec a pixel. RA, DEC: degrees,
// 0 0 for none. FOLDER: where the commands lie. "image" hands FITS-FILE over, "stars" a list of stars that
// StellarSolver extracts itself.

#include <cstdio>

#include <QCoreApplication>
#include <QFileInfo>
#include <QObject>
#include <QTimer>

#include <stellarsolver.h>

#include "../stellarsolver_frame.h"

int main(int count, char **given)
{
    QCoreApplication app(count, given);
    if (count != 11)
        return 2;
    RawFrame frame;
    if (!frame.read(given[2], given[3], given[4]))
        return 2;
    double scale = QString(given[5]).toDouble();
    double ra = QString(given[6]).toDouble(), dec = QString(given[7]).toDouble();
    QString folder = QString::fromUtf8(given[8]), kind = given[9];

    StellarSolver solver(frame.image, frame.data());
    ExternalProgramPaths paths = StellarSolver::getDefaultExternalPaths(LINUX_DEFAULT);
    paths.solverPath = folder + "/solve-field";
    paths.wcsPath = folder + "/wcsinfo";
    // it removes its configuration when it has solved, and by default that is the system's
    paths.confPath = QFileInfo(QString::fromUtf8(given[1])).absolutePath() + "/astrometry.cfg";
    paths.astapBinaryPath = folder + "/astap";
    paths.watneyBinaryPath = folder + "/watney-solve";
    solver.setExternalFilePaths(paths);
    solver.setProperty("ProcessType", SOLVE);
    solver.setProperty("ExtractorType", QString(given[10]) == "stars" ? EXTRACTOR_INTERNAL : EXTRACTOR_BUILTIN);
    solver.setProperty("SolverType", kind == "astap" ? SOLVER_ASTAP : kind == "watney" ? SOLVER_WATNEYASTROMETRY :
                       SOLVER_LOCALASTROMETRY);
    solver.setProperty("FileToProcess", QString::fromUtf8(given[1]));
    solver.setProperty("BasePath", QFileInfo(QString::fromUtf8(given[1])).absolutePath());
    solver.setSearchScale(0.9 * scale, 1.1 * scale, ARCSEC_PER_PIX);
    solver.setSearchPositionInDegrees(ra, dec);
    solver.setProperty("UseScale", true);
    solver.setProperty("UsePosition", ra != 0 || dec != 0);
    solver.setLogLevel(LOG_ALL);
    solver.setSSLogLevel(LOG_NORMAL);
    QObject::connect(&solver, &StellarSolver::logOutput, [](const QString &words) {
        std::fprintf(stderr, "%s\n", words.toUtf8().constData());
    });
    QObject::connect(&solver, &StellarSolver::finished, &app, [&]() {
        if (solver.solvingDone() && !solver.failed())
        {
            FITSImage::Solution found = solver.getSolution();
            std::printf("%.7f %.7f %.6f %.6f %.6f %.6f %d %d\n", found.ra, found.dec, found.pixscale, found.orientation,
                        found.fieldWidth, found.fieldHeight, int(found.parity), int(solver.hasWCSData()));
        }
        app.exit(solver.failed() ? 1 : 0);
    });
    QTimer::singleShot(120000, &app, [&]() { app.exit(3); });
    QTimer::singleShot(0, &app, [&]() { solver.start(); });
    return app.exec();
}
